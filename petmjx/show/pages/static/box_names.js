// Names of boxes. A box need not have an article or an id of its item.

export const NO_ARTICLE = "no article";

// "22 candy-00100723"; only the number if there is no article.
export const labelOf = (box, article) => (article ? `${box} ${article}` : `${box}`);

// "bread (item 00105329)", "bread", "item 00105329"; "" if there is neither.
export function goodsOf(article, item) {
  const number = item ? `item ${item}` : "";
  return article && number ? `${article} (${number})` : article || number;
}
