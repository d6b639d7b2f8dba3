// Numbers as text.

// A number with some decimals; "–" if there is none. Forces of boxes that just touch may be −0.04 N: they are shown
// as 0.
export function decimals(value, digits) {
  return Number.isFinite(value) ? value.toFixed(digits).replace(/^-(?=0\.?0*$)/, "") : "–";
}
