// A table of very many rows. Only the visible rows, and a few above and below them, are elements of the page.
//
//   const table = new Table(root, rows, {onOpen, onSort});   rows: Rows of rows.js
//   table.show(order, sort)   order: the rows to show; sort: "key" or "-key", for the headings
//   table.open(row)           marks the selected row; −1: none
//
// Keys: up, down, page up, page down, home, end move; enter and space open. Screen readers get the place from
// aria-rowindex and aria-rowcount.

import { make } from "./dom.js";

const ROW_PIXELS = 30;
const SPARE = 8; // rows above and below the visible ones
const LETTER = 8.8; // estimated width of a letter, pixels; it may be too large, but not too small
const PADDING = 24;
const NARROWEST = 6; // letters
const WIDEST = 30;

export class Table {
  constructor(root, rows, { onOpen, onSort }) {
    Object.assign(this, { rows, onOpen, onSort, order: new Uint32Array(), opened: -1, at: 0, asked: 0 });
    this.body = make("tbody");
    this.heads = rows.columns.map((column) => this.head(column));
    const head = make("thead", {}, make("tr", { "aria-rowindex": 1 }, ...this.heads));
    this.grid = make("table", { class: "rows" }, this.widths(), head, this.body);
    this.pane = make("div", { class: "pane", role: "region", "aria-label": "Table", tabindex: "-1" }, this.grid);
    this.pane.addEventListener("scroll", () => this.redraw(), { passive: true });
    this.body.addEventListener("click", (event) => this.clicked(event));
    this.body.addEventListener("keydown", (event) => this.pressed(event));
    new ResizeObserver(() => this.redraw()).observe(this.pane);
    root.replaceChildren(this.pane);
  }

  show(order, sort) {
    this.order = order;
    this.at = Math.min(this.at, Math.max(0, order.length - 1));
    this.grid.setAttribute("aria-rowcount", order.length + 1);
    this.rows.columns.forEach(({ key }, at) => {
      const way = sort === key ? "ascending" : sort === `-${key}` ? "descending" : null;
      if (way) this.heads[at].setAttribute("aria-sort", way);
      else this.heads[at].removeAttribute("aria-sort");
    });
    this.draw();
  }

  open(row) {
    this.opened = row;
    const at = this.order.indexOf(row);
    if (at >= 0) this.move(at, false);
    else this.draw();
  }

  // ---- private

  head({ key, label, unit, kind, meaning }) {
    const button = make("button", { type: "button", ...(meaning ? { title: meaning } : {}) }, label);
    if (unit) button.append(" ", make("small", {}, unit));
    button.addEventListener("click", () => this.onSort(key));
    return make("th", { scope: "col", ...(kind === "number" ? {} : { class: "text" }) }, button);
  }

  widths() {
    const group = make("colgroup");
    let whole = 0;
    for (const column of this.rows.columns) {
      const pixels = this.letters(column) * LETTER + PADDING;
      const col = make("col");
      col.style.width = `${pixels}px`;
      whole += pixels;
      group.append(col);
    }
    queueMicrotask(() => (this.grid.style.minWidth = `${whole}px`));
    return group;
  }

  letters({ key, kind, label, unit }) {
    const head = label.length + (unit ? unit.length + 1 : 0) + 2;
    if (kind === "number") return Math.max(NARROWEST, head);
    const longest = this.rows.texts[key].reduce((most, text) => Math.max(most, text.length), 0);
    return Math.min(WIDEST, Math.max(NARROWEST, head, longest));
  }

  redraw() {
    this.asked ||= requestAnimationFrame(() => this.draw());
  }

  draw() {
    cancelAnimationFrame(this.asked);
    this.asked = 0;
    const focused = this.body.contains(document.activeElement);
    const first = Math.max(0, Math.floor(this.pane.scrollTop / ROW_PIXELS) - SPARE);
    const many = Math.ceil(this.pane.clientHeight / ROW_PIXELS) + 2 * SPARE;
    const last = Math.min(this.order.length, first + many);
    const lines = [this.space(first)];
    for (let at = first; at < last; at++) lines.push(this.line(at));
    lines.push(this.space(this.order.length - last));
    this.body.replaceChildren(...lines);
    if (focused) this.body.querySelector('[tabindex="0"]')?.focus({ preventScroll: true });
  }

  // Rows that are not in the page, as one row of their total height.
  space(rows) {
    const line = make("tr", { class: "space", "aria-hidden": "true" });
    line.style.height = `${rows * ROW_PIXELS}px`;
    return line;
  }

  line(at) {
    const row = this.order[at];
    const line = make("tr", { "aria-rowindex": at + 2, tabindex: at === this.at ? "0" : "-1" });
    line.dataset.at = at;
    if (row === this.opened) line.setAttribute("aria-current", "true");
    for (const column of this.rows.columns) {
      const text = this.rows.shown(column, row);
      const cell = make(column.key === "plan" ? "th" : "td", {}, text);
      if (column.key === "plan") cell.scope = "row";
      if (column.kind !== "number") {
        cell.className = column.key === "verdict" || column.key === "other" ? `text ${text}` : "text";
        cell.title = text;
      }
      line.append(cell);
    }
    return line;
  }

  clicked(event) {
    const line = event.target.closest("tr[data-at]");
    if (line) this.choose(Number(line.dataset.at));
  }

  pressed(event) {
    const page = Math.max(1, Math.floor(this.pane.clientHeight / ROW_PIXELS) - 2);
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -Infinity, End: Infinity };
    if (event.key in steps) this.move(this.at + steps[event.key], true);
    else if (event.key === "Enter" || event.key === " ") this.choose(this.at);
    else return;
    event.preventDefault();
  }

  choose(at) {
    this.move(at, true);
    this.onOpen(this.order[at]);
  }

  // Makes the row at a place in the order the row from which keys move on, and scrolls this row into sight.
  move(at, focus) {
    this.at = Math.max(0, Math.min(this.order.length - 1, at));
    const head = this.heads[0].offsetHeight;
    const top = this.at * ROW_PIXELS;
    const room = this.pane.clientHeight - head - ROW_PIXELS;
    if (top < this.pane.scrollTop) this.pane.scrollTop = top;
    else if (top > this.pane.scrollTop + room) this.pane.scrollTop = top - room;
    this.draw();
    if (focus) this.body.querySelector('[tabindex="0"]')?.focus({ preventScroll: true });
  }
}
