// The page of a report. Its HTML has the charts and small tables. This module makes the table of plans and the 3D
// pictures. The address behind # has their state: filters, order, and the selected plan:
//
//   #q=milk&verdict=unstable&shift.min=20&sort=-margin&plan=s0-000013&variant=0&of=demo

import { readBlock, readInfo } from "./page_data.js";
import { byId } from "./dom.js";
import { Filters } from "./filters.js";
import { PlanView } from "./plan_view.js";
import { Rows } from "./rows.js";
import { Table } from "./table.js";

async function start() {
  const info = readInfo();
  const rows = new Rows(info, await readBlock("rows"));
  let state = readState();

  const filters = new Filters(byId("filters"), rows, (next) => apply(next));
  const table = new Table(byId("table"), rows, {
    onOpen: async (row) => {
      apply(opened(state, row));
      await drawn;
      if (isBelow(byId("plan"), byId("table"))) byId("plan").scrollIntoView(); // on a narrow screen
    },
    onSort: (key) => apply(sorted(state, key)),
  });
  const plan = new PlanView(byId("plan"), info, rows, () => apply(closed(state)));
  let shown = -1;
  let drawn = null; // promise that is fulfilled once the selected plan is drawn

  function apply(next) {
    state = next;
    writeState(state);
    show();
  }

  function show() {
    const order = rows.select(state);
    filters.show(state, order.length);
    table.show(order, state.get("sort") ?? "");
    const row = rowOf(state);
    if (row === shown) return;
    shown = row;
    byId("plans").classList.toggle("open", row >= 0);
    table.open(row);
    if (row < 0) plan.close();
    else drawn = plan.show(row);
  }

  function rowOf(asked) {
    const run = info.runs.findIndex(({ name }) => name === asked.get("of"));
    return asked.has("plan") ? rows.find(asked.get("plan"), Number(asked.get("variant") ?? 0), run) : -1;
  }

  function opened(from, row) {
    const next = closed(from);
    next.set("plan", rows.text("plan", row));
    if (rows.arrays.variant[row]) next.set("variant", rows.arrays.variant[row]);
    if (info.runs.length > 1) next.set("of", info.runs[rows.arrays.of[row]].name);
    return next;
  }

  // The user followed a link in a chart or a list. The link sets the filters of the table.
  addEventListener("hashchange", () => {
    if (!location.hash.includes("=")) return;
    state = readState();
    show();
    byId("plans").scrollIntoView();
  });
  show();
  if (state.toString()) byId("plans").scrollIntoView();
  document.documentElement.dataset.ready = "true";
}

// Links to sections (#plans) have no "=", and no state.
function readState() {
  const text = location.hash.slice(1);
  return new URLSearchParams(text.includes("=") ? text : "");
}

// Changes the address without a new entry in the browser's history. So "back" leaves the page, and does not undo single
// letters of a search.
function writeState(state) {
  const text = state.toString();
  history.replaceState(null, "", text ? `#${text}` : location.href.split("#")[0]);
}

function isBelow(one, other) {
  return one.getBoundingClientRect().top >= other.getBoundingClientRect().bottom;
}

function closed(from) {
  const next = new URLSearchParams(from);
  for (const key of ["plan", "variant", "of"]) next.delete(key);
  return next;
}

// The next order: rising, falling, original.
function sorted(from, key) {
  const next = new URLSearchParams(from);
  const now = from.get("sort");
  if (now === key) next.set("sort", `-${key}`);
  else if (now === `-${key}`) next.delete("sort");
  else next.set("sort", key);
  return next;
}

start();
