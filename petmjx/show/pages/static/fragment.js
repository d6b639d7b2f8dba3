// What a report shows, as it stands in the address behind #: filters, order, and the plan that is looked at:
//
//   #q=milk&verdict=unstable&shift.min=20&sort=-margin&plan=s0-000013&variant=0&of=demo

// Links to sections (#plans) have no "=", and say nothing of this.
export function readState() {
  const text = location.hash.slice(1);
  return new URLSearchParams(text.includes("=") ? text : "");
}

// Changes the address in place: going back leaves the page, and does not undo single letters of a search.
export function writeState(state) {
  const text = state.toString();
  history.replaceState(null, "", text ? `#${text}` : location.href.split("#")[0]);
}
