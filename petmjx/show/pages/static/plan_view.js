// The selected plan: its outcome and its world in 3D, in every run that has it.

import { Card } from "./world_card.js";
import { make } from "./dom.js";
import { endedWorld } from "./final_boxes.js";

const MOST_CARDS = 6; // largest number of 3D pictures side by side; browsers limit the number of WebGL contexts

export class PlanView {
  constructor(root, info, rows, onClose) {
    Object.assign(this, { root, info, rows, onClose, cards: [], asked: 0 });
  }

  close() {
    this.asked += 1;
    this.cards.forEach((card) => card.dispose());
    this.cards = [];
    this.root.replaceChildren();
    this.root.className = "";
  }

  // Resolves once the pictures are drawn, or earlier if another plan is selected meanwhile.
  async show(row) {
    this.close();
    const asked = this.asked;
    const id = this.rows.text("plan", row);
    const variant = this.rows.arrays.variant[row];
    const found = this.everyRow(id, variant, row);
    const close = make("button", { type: "button" }, "Close");
    close.addEventListener("click", this.onClose);
    const title = this.rows.column("variant") ? `${id} / ${variant}` : id;
    this.root.className = found.length > 1 ? "several" : "one";
    this.root.append(make("div", { class: "line" }, make("h3", {}, title), close));
    this.root.append(...found.map((each) => this.words(each)));
    const box = make("div", { class: "cards3d" });
    this.root.append(box, this.howToSeeItMove(id, variant, row));
    for (const each of found) {
      const card = await this.card(each);
      if (asked !== this.asked) return;
      box.append(card.element ?? card);
      if (card.element) this.cards.push(card);
    }
    this.cards.forEach((card) => card.start());
  }

  // ---- private

  // The row itself, and the rows of the same world in the other runs.
  everyRow(id, variant, row) {
    const others = this.info.runs.map((_, run) => run).filter((run) => run !== this.rows.arrays.of[row]);
    const found = [row, ...others.map((run) => this.rows.find(id, variant, run)).filter((each) => each >= 0)];
    return found.sort((a, b) => this.rows.arrays.of[a] - this.rows.arrays.of[b]).slice(0, MOST_CARDS);
  }

  runOf(row) {
    return this.info.runs[this.rows.arrays.of[row]];
  }

  first(row) {
    const box = this.rows.arrays.first?.[row] ?? NaN;
    return Number.isNaN(box) ? -1 : box;
  }

  words(row) {
    const [verdict, reason] = [this.rows.text("verdict", row), this.rows.text("reason", row)];
    const line = make("p");
    if (this.info.runs.length > 1) line.append(`${this.runOf(row).name}: `);
    line.append(make("strong", { class: verdict }, reason ? `${verdict}, ${reason}` : verdict), ".");
    const first = this.first(row);
    if (first >= 0) {
      const when = this.rows.arrays.sign?.[row];
      const at = Number.isFinite(when) ? ` at ${when.toFixed(2)} s` : "";
      const article = this.rows.text("article", row);
      line.append(` Box ${first}${article ? ` (${article})` : ""} failed first${at}.`);
    }
    const { boxes, placed } = this.rows.arrays;
    if (placed && placed[row] < boxes[row]) line.append(` ${placed[row]} of ${boxes[row]} boxes were placed.`);
    return line;
  }

  async card(row) {
    const number = this.rows.arrays.drawn[row];
    const run = this.runOf(row);
    if (number < 0) {
      const why = run.missing ? ` (${run.missing})` : "";
      return make("p", { class: "hint" }, `${run.name}: no 3D picture${why}.`);
    }
    const world = await endedWorld(number, this.info.worldsPerBlock);
    return new Card(this.info, run, this.first(row), world, this.rows.arrays.replay[row]);
  }

  howToSeeItMove(id, variant, row) {
    const one = this.rows.column("variant") ? ` --variant ${variant}` : "";
    const [named, options] = [`${quoted(id)} ${this.runOf(row).folder}`, `${one} --html story.html`];
    // If an id begins with a dash, it is written after "--", so that the command line does not take it for an option.
    const command = `petmjx show${id.startsWith("-") ? `${options} -- ${named}` : ` ${named}${options}`}`;
    const line = make("p", { class: "hint" }, "To see it move: ", make("code", {}, command));
    if (this.rows.arrays.replay[row] < 0) {
      const run = make("code", {}, `petmjx ${this.runOf(row).command} … --record failed`);
      line.append("; to play it here: ", run, ", and a report of that run.");
    }
    return line;
  }
}

// Quoted for a shell.
function quoted(text) {
  return /^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", `'"'"'`)}'`;
}
