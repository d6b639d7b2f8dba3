// The state of a report in the address behind #: filters, order, and the selected plan:
//
//   #q=milk&verdict=unstable&shift.min=20&sort=-margin&plan=s0-000013&variant=0&of=demo

// Links to sections (#plans) have no "=", and no state.
export function readState() {
  const text = location.hash.slice(1);
  return new URLSearchParams(text.includes("=") ? text : "");
}

// Changes the address without a new entry in the browser's history. So "back" leaves the page, and does not undo single
// letters of a search.
export function writeState(state) {
  const text = state.toString();
  history.replaceState(null, "", text ? `#${text}` : location.href.split("#")[0]);
}
