// Keys of a story, wherever the focus is. Fields keep the keys that they need.

const TURN = 0.12; // radians
const ZOOM = 0.85;

export function listenToKeys({ player, viewer, toSign, faster, choose }) {
  const turns = {
    ArrowLeft: () => viewer.turn(-TURN, 0),
    ArrowRight: () => viewer.turn(TURN, 0),
    ArrowUp: () => viewer.turn(0, TURN),
    ArrowDown: () => viewer.turn(0, -TURN),
  };
  const acts = {
    " ": () => player.toggle(),
    ArrowLeft: () => player.step(-1),
    ArrowRight: () => player.step(1),
    Home: () => player.seek(player.frames.start),
    End: () => player.seek(player.frames.end),
    f: toSign,
    F: toSign,
    ",": () => faster(-1),
    "<": () => faster(-1),
    ".": () => faster(1),
    ">": () => faster(1),
    "+": () => viewer.zoom(ZOOM),
    "=": () => viewer.zoom(ZOOM),
    "-": () => viewer.zoom(1 / ZOOM),
    "−": () => viewer.zoom(1 / ZOOM),
    0: () => viewer.reset(),
    Escape: () => choose(-1),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || taken(event)) return;
    const act = (event.shiftKey && turns[event.key]) || acts[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
}

// Whether the element with the focus needs this key itself. Selection lists need all keys, buttons and check boxes need
// the space bar and Enter, and scrolled tables and legends need all keys but the space bar.
function taken({ key, target }) {
  if (target.matches("select")) return true;
  if (target.matches("button, summary, input[type=checkbox]")) return key === " " || key === "Enter";
  return target.matches(".wide, ul") && key !== " ";
}
