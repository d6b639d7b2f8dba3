// The filters above a report's table: search, verdicts, other choices, ranges of numbers.
//
//   const filters = new Filters(root, rows, onChange);   onChange(state) after every change
//   filters.show(state, count)                           sets the fields to a state

import { make } from "./dom.js";
import { onlyOpen } from "./rows.js";

const MOST_CHOICES = 500; // a column with more different texts gets no list of choices
const TYPING_MS = 120;

export class Filters {
  constructor(root, rows, onChange) {
    Object.assign(this, { rows, onChange, state: new URLSearchParams(), typing: 0 });
    this.fields = []; // [element, read(state)]
    this.said = make("p", { class: "faint", role: "status" });
    const clear = make("button", { type: "button" }, "Clear filters");
    clear.addEventListener("click", () => this.changed(onlyOpen(this.state)));
    const line = make("div", { class: "line" }, this.search(), this.verdicts(), ...this.choices());
    if (rows.arrays.other) line.append(this.flips());
    root.replaceChildren(line, this.ranges(), make("div", { class: "line" }, this.said, clear));
  }

  show(state, count) {
    this.state = state;
    for (const [field, read] of this.fields) read(field, state);
    const of = this.rows.n.toLocaleString("en");
    this.said.textContent = `${count.toLocaleString("en")} of ${of} shown`;
  }

  // ---- private

  changed(state) {
    this.state = state;
    this.onChange(state);
  }

  with(change) {
    const state = new URLSearchParams(this.state);
    change(state);
    this.changed(state);
  }

  // A text field whose changes take effect when the user stops typing.
  typed(field, key) {
    field.addEventListener("input", () => {
      clearTimeout(this.typing);
      this.typing = setTimeout(() => this.with((state) => put(state, key, field.value.trim())), TYPING_MS);
    });
    this.fields.push([field, (element, state) => {
      if (element !== document.activeElement) element.value = state.get(key) ?? "";
    }]);
    return field;
  }

  search() {
    const field = make("input", { type: "search", placeholder: "Plan or first article", "aria-label": "Search" });
    return this.typed(field, "q");
  }

  verdicts() {
    const group = make("fieldset", {}, make("legend", { class: "unseen" }, "Verdict"));
    for (const verdict of this.rows.texts.verdict ?? []) {
      group.append(this.box("verdict", verdict, verdict, verdict));
    }
    return group;
  }

  flips() {
    return this.box("flip", "1", "verdicts that differ", "");
  }

  box(key, value, label, look) {
    const field = make("input", { type: "checkbox" });
    field.addEventListener("change", () => this.with((state) => {
      const others = state.getAll(key).filter((each) => each !== value);
      state.delete(key);
      for (const each of field.checked ? [...others, value] : others) state.append(key, each);
    }));
    this.fields.push([field, (element, state) => (element.checked = state.getAll(key).includes(value))]);
    return make("label", { class: "tick" }, field, make("span", { class: look }, label));
  }

  choices() {
    const listed = this.rows.columns.filter(({ key, kind }) => {
      const many = this.rows.texts[key]?.length ?? 0;
      return kind === "choice" && !["verdict", "other"].includes(key) && many > 1 && many <= MOST_CHOICES;
    });
    return listed.map(({ key, label }) => this.list(key, label));
  }

  list(key, label) {
    const options = [...this.rows.texts[key]].sort(new Intl.Collator("en", { numeric: true }).compare);
    const any = make("option", { value: "" }, `any ${label}`);
    const all = options.map((text) => make("option", { value: text }, text));
    const field = make("select", { "aria-label": label }, any, ...all);
    field.addEventListener("change", () => this.with((state) => put(state, key, field.value)));
    this.fields.push([field, (element, state) => (element.value = state.get(key) ?? "")]);
    return field;
  }

  ranges() {
    const columns = this.rows.columns.filter(({ kind }) => kind === "number");
    const lines = columns.map(({ key, label, unit }) => {
      const name = unit ? `${label}, ${unit}` : label;
      const ends = ["min", "max"].map((end) => {
        const words = { placeholder: end, "aria-label": `${name}: ${end}` };
        return this.typed(make("input", { type: "number", step: "any", ...words }), `${key}.${end}`);
      });
      return make("div", { class: "range" }, make("span", {}, name), ...ends);
    });
    const box = make("details", {}, make("summary", {}, "Ranges of numbers"), make("div", { class: "ranges" }, ...lines));
    const set = (state) => columns.some(({ key }) => state.has(`${key}.min`) || state.has(`${key}.max`));
    this.fields.push([box, (element, state) => (element.open ||= set(state))]);
    return box;
  }
}

function put(state, key, value) {
  if (value) state.set(key, value);
  else state.delete(key);
}
