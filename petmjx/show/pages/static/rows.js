// The rows of a report's table (petmjx/show/report/report_plan_table.py): filters them and sorts them.

const OPEN = ["plan", "variant", "of"]; // keys of the page's address that name the selected plan; they filter nothing
const MINUS = "−";

export class Rows {
  constructor({ columns, texts, n }, arrays) {
    Object.assign(this, { columns, texts, n, arrays });
    this.formats = new Map();
    this.ranks = new Map();
  }

  column(key) {
    return this.columns.find((column) => column.key === key);
  }

  // The text of a plan's id, a choice, …; "" if there is none.
  text(key, row) {
    return this.arrays[key] ? (this.texts[key][this.arrays[key][row]] ?? "") : "";
  }

  // A cell as text.
  shown({ key, kind, digits }, row) {
    if (kind !== "number") return this.text(key, row);
    return this.number(this.arrays[key][row], digits);
  }

  number(value, digits) {
    if (!Number.isFinite(value)) return "";
    if (!this.formats.has(digits)) {
      const places = { maximumFractionDigits: digits, minimumFractionDigits: digits > 2 ? 0 : digits };
      this.formats.set(digits, new Intl.NumberFormat("en", places));
    }
    return this.formats.get(digits).format(value).replace(/^-(.*[1-9].*)$/, `${MINUS}$1`).replace(/^-/, "");
  }

  find(plan, variant, run) {
    const code = this.texts.plan.indexOf(plan);
    const { plan: plans, variant: variants, of } = this.arrays;
    if (code >= 0) {
      for (let row = 0; row < this.n; row++) {
        if (plans[row] === code && variants[row] === variant && (run < 0 || of[row] === run)) return row;
      }
    }
    return -1;
  }

  // The rows that pass the filters, in order: a Uint32Array.
  select(state) {
    const tests = this.tests(state);
    const kept = new Uint32Array(this.n);
    let count = 0;
    for (let row = 0; row < this.n; row++) {
      if (tests.every((passes) => passes(row))) kept[count++] = row;
    }
    return this.sorted(kept.subarray(0, count), state.get("sort") ?? "");
  }

  tests(state) {
    const found = [];
    const words = (state.get("q") ?? "").trim().toLowerCase();
    if (words) found.push(this.holds(words));
    for (const { key, kind } of this.columns) {
      const values = this.arrays[key];
      if (kind === "choice" && state.has(key)) {
        const wanted = new Set(state.getAll(key).map((text) => this.texts[key].indexOf(text)));
        found.push((row) => wanted.has(values[row]));
      } else if (kind === "number") {
        const [least, most] = ["min", "max"].map((end) => bound(state.get(`${key}.${end}`)));
        if (least !== null) found.push((row) => values[row] >= least);
        if (most !== null) found.push((row) => values[row] <= most);
      }
    }
    if (state.get("flip") && this.arrays.other) {
      found.push((row) => this.text("other", row) !== "" && this.text("other", row) !== this.text("verdict", row));
    }
    return found;
  }

  // Whether a row's plan or first article contains these letters.
  holds(words) {
    const keys = ["plan", "article"].filter((key) => this.arrays[key]);
    const hits = keys.map((key) => this.texts[key].map((text) => text.toLowerCase().includes(words)));
    return (row) => keys.some((key, at) => hits[at][this.arrays[key][row]]);
  }

  // Sorts by a column; "-" before its key means falling. Rows without a value come last in both orders.
  sorted(rows, order) {
    const falling = order.startsWith("-");
    const column = this.column(falling ? order.slice(1) : order) ?? this.column("plan");
    const values = this.sortable(column);
    const sign = falling ? -1 : 1;
    return rows.slice().sort((a, b) => {
      const [left, right] = [values[a], values[b]];
      if (Number.isNaN(left) || Number.isNaN(right)) return Number.isNaN(left) - Number.isNaN(right) || a - b;
      return sign * (left - right) || a - b;
    });
  }

  // For each row, a number. The numbers sort the rows by their texts, with "plan 9" before "plan 10".
  sortable({ key, kind }) {
    if (kind === "number") return this.arrays[key];
    if (!this.ranks.has(key)) {
      const texts = this.texts[key];
      const collator = new Intl.Collator("en", { numeric: true });
      const order = texts.map((_, code) => code).sort((a, b) => collator.compare(texts[a], texts[b]));
      const rank = new Float64Array(texts.length);
      order.forEach((code, place) => (rank[code] = place));
      this.ranks.set(key, Float64Array.from(this.arrays[key], (code) => (code < 0 ? NaN : rank[code])));
    }
    return this.ranks.get(key);
  }
}

function bound(text) {
  const value = Number.parseFloat(text ?? "");
  return Number.isFinite(value) ? value : null;
}

// A state that keeps only the selected plan of another state. The button "Clear" sets this state.
export function onlyOpen(state) {
  return new URLSearchParams([...state].filter(([key]) => OPEN.includes(key)));
}
