// The page: joins what is live, what is recorded, and what is shown.

import { BodyPanel } from "./body.js";
import { Bodies } from "./bodies.js";
import { Colours } from "./colours.js";
import { Comparison } from "./comparison.js";
import { Figures, metres, number } from "./figures.js";
import { frameOf } from "./frame.js";
import { Hands } from "./hands.js";
import { History } from "./history.js";
import { Link } from "./link.js";
import { Live, obstacle, sentence } from "./live.js";
import { AWAY, openRecording } from "./recording.js";
import { Roster } from "./roster.js";
import { Stage } from "./stage.js";
import { theme } from "./theme.js";
import { Trail } from "./trail.js";

const element = (id) => document.getElementById(id);
const COLOURS = ["error", "rest", "age", "shape"];
/**
 * Turns of the event loop before a frame, at most; and their time: a share of the last frame's, so that fast ones stay
 * fast, and at least some milliseconds.
 */
const ARRIVAL_TURNS = 12;
const ARRIVAL_SHARE = 0.2;
const ARRIVAL_MS_MIN = 3;
/** Times of frames that are kept for the figures of a test. */
const FRAME_TIMES = 600;

const live = new Live();
const roster = new Roster();
const history = new History();
const comparison = new Comparison();
const colours = new Colours();
const link = new Link(element);
const figures = new Figures(element);
const panel = new BodyPanel(element);
let stage;
let bodies;
let ghosts;
let trail;
let hands;
/** The layout that each set of bodies has: a generation, and its source. */
let laidOut;
let ghostsLaidOut;
/** `"live"`, a place in the history, or a recording. */
let mode = { kind: "live" };
let lastFrame = 0;
let scene;
/** The frame of the history or of a recording that was drawn last. */
let lastShown;
/** True if there is something to say about the connection. */
let noticed = false;

/** Counts since the page was loaded, for scripts that drive it. */
const diagnostics = {
  state: "starting",
  frames: 0,
  frameTimes: [],
  workTimes: [],
  time: 0,
  bodies: 0,
  comparison,
  /** The frame that is shown. A live one's columns are those of the copy, and end with its next call. */
  get shown() {
    return mode.kind === "live" ? live.copy && frameOf(live.copy.view, false) : lastShown;
  },
  get carried() {
    return hands?.carried;
  },
  get lastAdded() {
    return hands?.lastAdded;
  },
  get trail() {
    return trail?.counts;
  },
  get picked() {
    return panel.id;
  },
  /** Of every body that can move, three numbers from 0 to 1. */
  drawnColours: () => Array.from(bodies.movable, (place) => bodies.drawnColour(place)),
  drawnPosition: (place) => bodies.drawnPosition(place),
  ghostPosition: (place) => (ghosts.visible ? ghosts.drawnPosition(place) : undefined),
};
globalThis.rhumbDiagnostics = diagnostics;

/** Shows a notice, or none. While a recording plays, it waits: it is about the connection. */
function notice(title, text) {
  noticed = title !== undefined;
  const box = element("notice");
  box.hidden = !noticed || mode.kind === "recording";
  if (!noticed) return;
  box.querySelector("h2").textContent = title;
  box.querySelector("p").textContent = text;
}

function hint(text) {
  element("status").textContent = text;
}

function start() {
  theme(element("theme"), (isDark) => {
    if (trail === undefined) return;
    ghosts.ghostColour = trail.colour = isDark ? 0xffffff : 0x000000;
  });
  try {
    stage = new Stage(element("view"));
  } catch {
    notice("This browser cannot draw the scene", "Turn on WebGL in its settings, or open the page in another browser.");
    return;
  }
  bodies = new Bodies(stage.scene);
  ghosts = new Bodies(stage.scene, { ghost: true });
  ghosts.visible = false;
  trail = new Trail(bodies);
  hands = new Hands(stage, live);
  hands.onerror = hint;
  link.onerror = hint;
  controls();
  pointers();
  keys();
  recordings();
  const wrong = obstacle();
  if (wrong !== undefined) {
    diagnostics.state = "impossible";
    notice(...wrong);
    hint("Recordings can be played");
  } else {
    begin();
  }
  requestAnimationFrame(frame);
}

/** Reads the scenes, and follows the first one. */
async function begin() {
  live.onstate = (state, text) => {
    diagnostics.state = state;
    if (mode.kind !== "recording") hint(text);
    if (state === "lost") notice("The connection has ended", `${text} The page tries to connect again.`);
    else if (state === "open") notice(undefined);
  };
  live.onjoin = (copy) => {
    laidOut = ghostsLaidOut = undefined;
    history.clear();
    figures.restart();
    hands.restart();
    if (mode.kind !== "recording") pick(undefined);
    comparison.restart();
    if (element("policy").checked) copy.setTierPolicy({ upTo: 0.2 });
    else copy.setTierPolicy("never");
    offer();
    link.read();
  };
  const first = await firstScene();
  offer();
  notice(undefined);
  follow(first.name);
}

/** The scene of the URL, or the server's first; waits until there is one. */
async function firstScene() {
  const wanted = new URLSearchParams(location.search).get("scene");
  for (;;) {
    try {
      const { scenes } = await live.read();
      if (scenes.length > 0) return scenes.find(({ name }) => name === wanted) ?? scenes[0];
      notice(
        "The server has no scene yet",
        "Let a client create one, or start `rhumb-server demo`. The page looks again.",
      );
    } catch (cause) {
      diagnostics.state = "lost";
      const text = cause instanceof TypeError ? "Is it running?" : sentence(cause.message);
      notice("The server does not answer", `${text} The page tries again.`);
    }
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}

/** Offers the server's scenes. */
function offer() {
  const select = element("scene");
  const names = live.facts.scenes.map(({ name }) => name);
  if (scene !== undefined && !names.includes(scene)) names.push(scene);
  if ([...select.options].map(({ value }) => value).join() === names.join()) return;
  select.replaceChildren(...names.map((name) => new Option(name, name, false, name === scene)));
}

function follow(name) {
  scene = name;
  element("scene").value = name;
  stage.lookAtScene(name);
  toLive();
  live.follow(name);
}

// Frames -------------------------------------------------------------------------------------------------------------

async function frame() {
  try {
    await showNow();
  } finally {
    // A frame that failed is reported, and does not end the page.
    requestAnimationFrame(frame);
  }
}

async function showNow() {
  await arrivals();
  const now = performance.now();
  const seconds = Math.min(0.25, (now - lastFrame) / 1000);
  note(diagnostics.frameTimes, now - lastFrame);
  lastFrame = now;
  if (live.copy !== undefined) showLive(now, seconds);
  if (mode.kind === "history") showFrame(mode.frame, now / 1000);
  if (mode.kind === "recording") showRecording(seconds, now / 1000);
  stage.draw();
  note(diagnostics.workTimes, performance.now() - now);
  diagnostics.frames++;
}

/**
 * Lets what has arrived be handled before a frame is computed. A browser that draws slowly prefers frames to it, and the
 * page would predict what it could know.
 */
async function arrivals() {
  const begin = performance.now();
  const end = begin + Math.max(ARRIVAL_MS_MIN, ARRIVAL_SHARE * (begin - lastFrame));
  for (let turn = 0; turn < ARRIVAL_TURNS && performance.now() < end; turn++) {
    const before = live.copy?.statistics.receivedDatagrams;
    await new Promise((resolve) => setTimeout(resolve));
    if (live.copy?.statistics.receivedDatagrams === before) return;
  }
}

function note(times, time) {
  times.push(time);
  if (times.length > FRAME_TIMES) times.shift();
}

/** Computes the live frame and what follows from it; draws it unless something else is shown. */
function showLive(now, seconds) {
  const { copy, truth } = live;
  const at = now / 1000;
  const statistics = copy.statistics;
  const time = showMoment(copy, now, statistics);
  roster.read(frameOf(copy.view, false), copy);
  if (mode.kind === "live") lay(copy);
  truth?.read();
  const seen = frameOf(copy.view);
  if (truth !== undefined) {
    comparison.show(seen, roster, time <= statistics.completeTick);
    comparison.settle(truth);
  }
  const errors = truth && comparison.generation === seen.generation ? comparison.errors : undefined;
  if (mode.kind === "live") {
    history.add(seen, errors, roster, at);
    bodies.pose(seen, seen.changed);
    colours.marked = placeOfPicked(seen);
    colours.apply(bodies, seen, errors, at);
    // A value beyond the greatest one would be cut.
    element("scrubber").max = Math.max(0, history.length - 1);
    element("scrubber").value = element("scrubber").max;
    // The present moment is predicted beyond the truth that has arrived.
    layGhosts(truth?.at(time) ?? truth?.at(truth.newest), seen.ids, roster, roster.shapes);
  }
  hands.act(seen, copy.view.linearVelocities, seconds, player());
  let moving = 0;
  for (const place of roster.movable) moving += 1 - seen.resting[place];
  const picked = placeOfPicked(seen);
  const ofPicked = {
    place: picked,
    error: errors?.[picked],
    tolerance: seen.tolerances[picked],
    bound: seen.errorBounds[picked],
  };
  if (mode.kind === "live") trail.show(seen, picked);
  // From here on the columns may end.
  if (mode.kind === "live" && panel.id !== undefined) panel.show(copy, { ...ofPicked, time, now: at });
  Object.assign(diagnostics, { time, bodies: roster.movable.length, moving, completeTick: statistics.completeTick });
  counts(time, moving, statistics);
  figures.count({
    now: at,
    client: copy,
    statistics,
    movable: roster.movable.length,
    comparison: truth && comparison,
    tolerance: toleranceOf(copy),
  });
  events(copy);
}

/** The place of the picked body in a frame; negative if there is none. */
function placeOfPicked({ ids, positions }) {
  const place = panel.id === undefined ? -1 : ids.indexOf(panel.id);
  return positions[3 * place] === AWAY ? -1 : place;
}

/** Has the panel show another body, or none. */
function pick(id) {
  panel.pick(id);
  trail.clear();
}

/** Removes the picked body, or the last one that was added. The ids of a recording are not those of the scene. */
function removePicked() {
  if (mode.kind !== "recording") hands.remove(panel.id);
}

/** Has the copy show the chosen moment; returns it. */
function showMoment(copy, now, { completeTick, watermarkTick }) {
  const { value } = element("shown");
  if (value === "predicted") return copy.poll(now);
  // A view does not go back.
  const time = Math.max(value === "complete" ? completeTick : watermarkTick, copy.view.time);
  copy.show(time);
  return time;
}

/** Lays out the bodies of the copy if they are others than before. */
function lay(copy) {
  if (laidOut === roster.generation) return;
  laidOut = roster.generation;
  bodies.layout(roster, (shape) => roster.shapes.get(shape));
  const seen = frameOf(copy.view, false);
  bodies.pose(seen, seen.ids.keys());
}

/** Puts the ghosts where the truth has the bodies that are shown; without the truth, there are none. */
function layGhosts(actual, ids, layout, shapes) {
  ghosts.visible = element("ghosts").checked && actual !== undefined;
  if (!ghosts.visible) return;
  if (ghostsLaidOut !== layout.generation) {
    ghostsLaidOut = layout.generation;
    ghosts.layout(layout, (shape) => shapes.get(shape));
  }
  ghosts.poseOthers(actual, ghosts.movable, (place) => actual.places.get(ids[place]));
}

function toleranceOf(copy) {
  const { tolerance } = copy;
  return typeof tolerance === "object" ? tolerance.position : tolerance;
}

function counts(time, moving, { errorScale }) {
  if (mode.kind !== "live") return;
  const truth = live.truth === undefined ? "" : `, greatest error ${metres(comparison.worst)}`;
  element("counts").textContent = `tick ${time}, ${roster.movable.length} bodies, ${moving} moving${truth}`;
  const scale = element("scale");
  // A stream with a budget may not have stated it yet.
  scale.hidden = (errorScale ?? 1) === 1;
  if (!scale.hidden) scale.textContent = `over budget: errors up to ${number(errorScale, 1)} tolerances`;
}

/** The id of the body that keys drive. */
function player() {
  return live.facts?.scenes.find(({ name }) => name === scene)?.player;
}

function events(copy) {
  for (let event = copy.pollEvent(); event !== undefined; event = copy.pollEvent()) {
    if (event.kind === "refused" || event.kind === "denied") hint(sentence(event.message));
    if (event.kind === "tierChanged" || event.kind === "subscriptionChanged") showTolerance(event.to ?? event.stream);
    if (event.kind === "sceneFaulted")
      notice("The scene stands still", "Its physics engine failed. Follow another scene.");
  }
}

/** Shows a frame of the history or of a recording. */
function showFrame(shown, now) {
  const isNew = laidOut !== shown.generation;
  if (isNew) {
    laidOut = shown.generation;
    bodies.layout(shown, (shape) => shown.shapesByNumber.get(shape));
  }
  lastShown = shown;
  const actual = mode.kind === "history" ? live.truth?.at(shown.time) : undefined;
  layGhosts(actual, shown.ids, shown, shown.shapesByNumber);
  bodies.pose(shown, isNew ? shown.ids.keys() : shown.changed);
  colours.marked = placeOfPicked(shown);
  colours.apply(bodies, shown, shown.errors, now);
  trail.show(shown, colours.marked);
  if (panel.id !== undefined) panel.showFrame(shown, colours.marked, now);
  element("counts").textContent = `tick ${shown.time}, ${bodies.movable.length} bodies`;
}

// Time ---------------------------------------------------------------------------------------------------------------

function toLive() {
  // The bodies of a recording are others.
  if (mode.kind === "recording") pick(undefined);
  history.interrupt();
  bodies.down = [0, -1, 0];
  mode = { kind: "live" };
  laidOut = undefined;
  element("notice").hidden = !noticed;
  element("live").textContent = "Pause";
  element("moment").textContent = "live";
}

function toHistory(index) {
  if (history.length === 0) return;
  const place = Math.max(0, Math.min(history.length - 1, index));
  mode = { kind: "history", index: place, frame: history.frame(place) };
  element("live").textContent = "Back to live";
  element("scrubber").value = place;
  const ago = history.at(history.length - 1) - history.at(place);
  element("moment").textContent = `${number(ago, 1)} s ago`;
}

function showRecording(seconds, now) {
  const { recording } = mode;
  if (!mode.isPaused) mode.at = Math.min(recording.length, mode.at + seconds);
  const scrubber = element("scrubber");
  scrubber.max = Math.round(1000 * recording.length);
  if (!mode.isPaused) scrubber.value = Math.round(1000 * mode.at);
  element("moment").textContent = `${number(mode.at, 1)} of ${number(recording.length, 1)} s`;
  showFrame(recording.frame(mode.at), now);
}

function play(recording) {
  pick(undefined);
  mode = { kind: "recording", recording, at: 0, isPaused: false };
  laidOut = undefined;
  bodies.down = recording.gravity;
  element("live").textContent = "Back to live";
  element("notice").hidden = true;
  hint(recording.title);
  stage.look([18, 14, 22], [0, 2, 0]);
}

function pauseOrGoOn() {
  if (mode.kind === "recording") mode.isPaused = !mode.isPaused;
  else if (mode.kind === "live") toHistory(history.length - 1);
  else toLive();
}

function step(by) {
  if (mode.kind === "recording") {
    mode.isPaused = true;
    mode.at = Math.max(0, Math.min(mode.recording.length, mode.at + by / 60));
    element("scrubber").value = Math.round(1000 * mode.at);
  } else {
    toHistory((mode.index ?? history.length - 1) + by);
  }
}

// Controls -----------------------------------------------------------------------------------------------------------

/** The tolerance of a place of the slider: from 1 mm to 1 m, even in its logarithm. */
const toleranceAt = (place) => 10 ** (-3 + (3 * place) / 100);

function showTolerance(stream) {
  const within = stream?.within;
  const length = typeof within === "object" ? within.position : within;
  if (length === undefined) return;
  element("tolerance").value = Math.round(((Math.log10(length) + 3) * 100) / 3);
  element("tolerance-shown").textContent = metres(length);
  for (const button of document.querySelectorAll("[data-tolerance]")) {
    button.setAttribute("aria-pressed", Number(button.dataset.tolerance) === length);
  }
}

function setTolerance(length) {
  live.options.tolerance = length;
  showTolerance({ within: length });
  if (live.copy?.state === "open") live.copy.changeStream({ within: length });
}

/** Sets the delay of a view that predicts. */
function setDelay(ticks) {
  live.options.delayTicks = ticks;
  live.copy?.setDelayTicks(ticks);
  element("delay").value = ticks;
  element("delay-shown").textContent = `${ticks} ticks`;
}

function controls() {
  showTolerance({ within: live.options.tolerance });
  let calm;
  element("tolerance").addEventListener("input", ({ target }) => {
    const length = Number(toleranceAt(Number(target.value)).toPrecision(2));
    element("tolerance-shown").textContent = metres(length);
    clearTimeout(calm);
    calm = setTimeout(() => setTolerance(length), 200);
  });
  for (const button of document.querySelectorAll("[data-tolerance]")) {
    button.addEventListener("click", () => setTolerance(Number(button.dataset.tolerance)));
  }
  element("delay").addEventListener("input", ({ target }) => setDelay(Number(target.value)));
  element("shown").addEventListener(
    "change",
    ({ target }) => (element("delay").disabled = target.value !== "predicted"),
  );
  setDelay(live.options.delayTicks);
  element("policy").addEventListener("change", ({ target }) => {
    live.copy?.setTierPolicy(target.checked ? { upTo: 0.2 } : "never");
  });
  element("scene").addEventListener("change", ({ target }) => follow(target.value));
  element("colour").addEventListener("change", ({ target }) => (colours.mode = target.value));
  element("flashes").addEventListener("change", ({ target }) => (colours.flashes = target.checked));
  element("truth").addEventListener("change", ({ target }) => {
    live.showTruth(target.checked).catch((cause) => hint(cause.message));
  });
  element("live").addEventListener("click", () => (mode.kind === "live" ? toHistory(history.length - 1) : toLive()));
  element("scrubber").addEventListener("input", ({ target }) => {
    if (mode.kind !== "recording") return toHistory(Number(target.value));
    mode.isPaused = true;
    mode.at = Number(target.value) / 1000;
  });
  element("throw").addEventListener("click", () => hands.throwBall());
  element("spawn").addEventListener("click", () => hands.dropBox());
  element("remove").addEventListener("click", removePicked);
}

function pointers() {
  const canvas = element("view");
  let pressed;
  canvas.addEventListener(
    "pointerdown",
    (event) => {
      canvas.focus({ preventScroll: true });
      pressed = [event.clientX, event.clientY];
      if (!event.shiftKey || mode.kind !== "live") return;
      const hit = bodies.pick(stage.ray(event));
      const id = hit && live.copy?.view.ids[hit.place];
      if (id === undefined) return;
      event.stopImmediatePropagation();
      canvas.setPointerCapture(event.pointerId);
      hands.carry(id, hit.point, event);
    },
    { capture: true },
  );
  canvas.addEventListener("pointermove", (event) => hands.move(event));
  canvas.addEventListener("pointerup", (event) => {
    if (hands.carried !== undefined) return hands.drop();
    const moved = pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
    if (moved === undefined || moved > 4) return;
    const hit = bodies.pick(stage.ray(event));
    const ids = mode.kind === "live" ? live.copy?.view.ids : lastShown?.ids;
    pick(hit && ids?.[hit.place]);
    if (hit) element("body-panel").open = true;
  });
}

function keys() {
  const actions = {
    KeyT: () => hands.throwBall(),
    KeyN: () => hands.dropBox(),
    Delete: removePicked,
    KeyP: pauseOrGoOn,
    ArrowLeft: () => step(-1),
    ArrowRight: () => step(1),
    KeyC: () => choose("colour", COLOURS[(COLOURS.indexOf(colours.mode) + 1) % COLOURS.length]),
    KeyG: () => element("ghosts").click(),
    KeyF: () => element("flashes").click(),
    Escape: () => {
      if (mode.kind !== "live") toLive();
      pick(undefined);
    },
  };
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target.matches("input, select, textarea");
    if (isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
    if (hands.press(event.code)) return event.preventDefault();
    const action = actions[event.code];
    if (action === undefined) return;
    event.preventDefault();
    action();
  });
  document.addEventListener("keyup", ({ code }) => hands.release(code));
  addEventListener("blur", () => hands.releaseAll());
}

function choose(id, value) {
  element(id).value = value;
  element(id).dispatchEvent(new Event("change"));
}

function recordings() {
  const open = async (file) => {
    if (file === undefined) return;
    try {
      hint(`Reading ${file.name}`);
      play(await openRecording(file));
    } catch (cause) {
      hint(`${file.name} cannot be played: ${cause.message}`);
    }
  };
  element("recording").addEventListener("change", ({ target }) => open(target.files[0]));
  // Anywhere on the page: where a drop is not handled, the browser leaves the page for the file.
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    open(event.dataTransfer.files[0]);
  });
}

start();
