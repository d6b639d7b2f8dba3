// Names of boxes, which need not have an article or an id of their item, and numbers as text.

export const NO_ARTICLE = "no article";

// "22 candy-00100723"; only the number if there is no article.
export const labelOf = (box, article) => (article ? `${box} ${article}` : `${box}`);

// "bread (item 00105329)", "bread", "item 00105329"; "" if there is neither.
export function goodsOf(article, item) {
  const number = item ? `item ${item}` : "";
  return article && number ? `${article} (${number})` : article || number;
}

// A number with some decimals; "–" if there is none. Forces of boxes that just touch may be −0.04 N: they are shown
// as 0.
export function decimals(value, digits) {
  return Number.isFinite(value) ? value.toFixed(digits).replace(/^-(?=0\.?0*$)/, "") : "–";
}
