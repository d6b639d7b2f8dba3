// Numbers as people read them.

// With so many decimals; "–" where there is no number. Forces of boxes that just touch may be −0.04 N: that is 0.
export function decimals(value, digits) {
  return Number.isFinite(value) ? value.toFixed(digits).replace(/^-(?=0\.?0*$)/, "") : "–";
}
