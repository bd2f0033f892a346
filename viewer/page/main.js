// The page: joins what is live, what is recorded, and what is shown.

import { readAddress, writeAddress } from "./address.js";
import { BodyPanel } from "./body.js";
import { Colours, showLegend } from "./colours.js";
import { choose, offer, onChoice, onValue, Tolerance } from "./controls.js";
import { Figures } from "./figures.js";
import { frameOf } from "./frame.js";
import { Hands } from "./hands.js";
import { Headline } from "./headline.js";
import { keys, pointers } from "./keys.js";
import { Link } from "./link.js";
import { LiveView } from "./live_view.js";
import { Pane } from "./pane.js";
import { OWN_RECORDINGS, Player } from "./player.js";
import { AWAY } from "./roster.js";
import { Stage } from "./stage.js";
import { metres, number, sentence } from "./text.js";
import { theme } from "./theme.js";

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
const colours = new Colours();
const figures = new Figures(element);
const headline = new Headline(element);
const panel = new BodyPanel(element);
const player = new Player(element);
const address = readAddress(location.search);
/** The connection to a server, and what it shows; a page without one has none. */
let live;
let view;
let hands;
let link;
let stage;
/** The copy at the right, and full states at the left. */
let pane;
let besidePane;
let tolerance;
/** `"live"`, a place in the history, or a recording. */
let mode = { kind: "starting" };
let lastFrame = 0;
let scene;
/** The frame of the history or of a recording that was drawn last. */
let lastShown;
/** Arguments of the last legend; undefined before there was one. */
let legendOf;
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
  get comparison() {
    return view?.comparison;
  },
  /** The frame that is shown. A live one's columns are those of the copy, and end with its next call. */
  get shown() {
    if (mode.kind === "live") return live.copy && frameOf(live.copy.view);
    return lastShown && { ...lastShown, ids: lastShown.layout.ids };
  },
  get carried() {
    return hands?.carried;
  },
  get lastAdded() {
    return hands?.lastAdded;
  },
  get trail() {
    return pane?.trail.counts;
  },
  get picked() {
    return panel.id;
  },
  /** The greatest errors of the last second, and bytes a second. */
  get sums() {
    return figures.sums;
  },
  /** Of every body that can move, three numbers from 0 to 1. */
  drawnColours: () => Array.from(pane.bodies.movable, (place) => pane.bodies.drawnColour(place)),
  drawnPosition: (place) => pane.bodies.drawnPosition(place),
  besidePosition: (place) => besidePane.bodies.drawnPosition(place),
  lines: () => Array.from(pane.offsets.ends),
  besideLines: () => Array.from(besidePane.offsets.ends),
  rings: () => pane.pulses.count,
  /** Where a body of the copy is seen, pixels of the page. */
  screenOf: (place) => stage.screenOf(pane.bodies.drawnPosition(place), pane.picture),
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

async function start() {
  try {
    stage = new Stage(element("view"), 2);
  } catch {
    notice("This browser cannot draw the scene", "Turn on WebGL in its settings, or open the page in another browser.");
    return;
  }
  besidePane = new Pane(stage.pictures[0], colours);
  pane = new Pane(stage.pictures[1], colours);
  theme(element("theme"), paint);
  player.onbegin = begun;
  player.onhint = hint;
  controls();
  showPanes(false);
  requestAnimationFrame(frame);
  if (OWN_RECORDINGS.length === 0) return beginLive();
  diagnostics.state = "recordings";
  document.body.dataset.mode = "recording";
  return player.playOwn();
}

/** Paints the pictures in the colours of the style sheet. */
function paint() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(name).trim();
  stage.ground = of("--sky");
  for (const each of [pane, besidePane]) each.paint({ ink: of("--ink"), off: of("--off"), ground: of("--floor") });
}

// The live scene ---------------------------------------------------------------------------------------------------

/** Connects to the server that the page came from. */
async function beginLive() {
  const { Live, obstacle } = await import("./live.js");
  live = new Live();
  view = new LiveView(live);
  view.isBeside = element("beside").checked;
  link = new Link(element);
  hands = new Hands(stage, live);
  hands.onerror = link.onerror = hint;
  link.onchange = (condition) => writeAddress({ link: condition });
  liveControls();
  if (mode.kind === "recording") element("live").textContent = "Back to live";
  else toLive();
  const wrong = obstacle();
  if (wrong !== undefined) {
    diagnostics.state = "impossible";
    notice(...wrong);
    hint("Recordings can be played");
    return;
  }
  live.onstate = (state, text) => {
    diagnostics.state = state;
    if (mode.kind !== "recording") hint(state === "open" ? [text, ...address.wrong].join(". ") : text);
    if (state === "lost") notice("The connection has ended", `${text} The page tries to connect again.`);
    else if (state === "open") notice(undefined);
  };
  live.onjoin = joined;
  followFirst();
}

/** The copy is another one. */
function joined(copy) {
  view.restart();
  hands.restart();
  if (mode.kind !== "recording") {
    figures.restart();
    pick(undefined);
  }
  copy.setTierPolicy(element("policy").checked ? { upTo: 0.2 } : "never");
  offerScenes();
  if (address.link === undefined) return link.read();
  // The address speaks of the page's beginning.
  link.set(address.link);
  address.link = undefined;
}

/** Follows the scene of the address, or the server's first; waits until there is one. */
async function followFirst() {
  for (;;) {
    try {
      const { scenes, several } = await live.read();
      const names = scenes.map(({ name }) => name);
      // Of several servers, another one may have it.
      if (several && address.scene !== undefined) names.push(address.scene);
      if (names.length > 0) {
        const isThere = names.includes(address.scene);
        if (address.scene !== undefined && !isThere)
          address.wrong.push(`The server has no scene "${address.scene}": ${names[0]} is shown`);
        notice(undefined);
        follow(isThere ? address.scene : names[0]);
        return;
      }
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
function offerScenes() {
  const names = live.facts.scenes.map(({ name }) => name);
  if (scene !== undefined && !names.includes(scene)) names.push(scene);
  offer(element("scene"), names, scene);
}

function follow(name) {
  scene = name;
  offerScenes();
  // A recording that was dropped on the page before its server answered stays.
  if (mode.kind !== "recording") {
    stage.lookAtScene(name);
    toLive();
  }
  live.follow(name);
}

/** Computes the live frame and what follows from it; draws it unless something else is shown. */
function showLive(now, seconds) {
  const { copy } = live;
  const at = now / 1000;
  const moment = element("shown").value;
  const read = view.read(now, moment, panel.id !== undefined);
  const { time, frame, errors, statistics } = read;
  const { movable } = frame.layout;
  const picked = placeOfPicked(frame);
  if (mode.kind === "live") {
    view.keep(read, at);
    showPictures(read, at);
  }
  let moving = 0;
  for (const place of movable) moving += 1 - frame.resting[place];
  const ofPicked = {
    place: picked,
    error: errors?.[picked],
    tolerance: frame.tolerances?.[picked],
    bound: frame.errorBounds?.[picked],
  };
  // From here on the columns may end.
  hands.act(frame, copy.view.linearVelocities, seconds, driven());
  if (mode.kind === "live" && panel.id !== undefined) panel.show(copy, { ...ofPicked, time, now: at });
  Object.assign(diagnostics, { time, bodies: movable.length, moving, completeTick: statistics.completeTick });
  if (mode.kind === "live") countLive(read, moving, moment, at);
  events(copy);
}

/** Counts what is shown live, for the graphs and the large numbers; shows them some times a second, as the page's text costs more. */
function countLive({ time, frame, statistics, naive, worst, tolerance, beside }, moving, moment, now) {
  const { receivedDatagramBytes, receivedControlBytes, updates, packets, missed, roundTrip } = statistics;
  const bytes = receivedDatagramBytes + receivedControlBytes;
  const counts = { now, bytes, naive, updates, packets, missed, roundTrip };
  const within = tolerance ?? toleranceOf(live.copy);
  if (!figures.count({ ...counts, worst, besideWorst: beside?.worst, tolerance: within })) return;
  const bodies = frame.layout.movable.length;
  element("counts").textContent = `tick ${time}, ${bodies} bodies, ${moving} moving`;
  scrub(view.history.length - 1);
  headline.show({
    sums: figures.sums,
    bodies,
    tolerance: within,
    moment,
    errorScale: statistics.errorScale,
    waiting: statistics.watermarkTick - statistics.completeTick,
  });
  legend(within, live.truth !== undefined);
}

function toleranceOf(copy) {
  const { tolerance } = copy;
  return typeof tolerance === "object" ? tolerance.position : tolerance;
}

/** The id of the body that keys drive. */
function driven() {
  return live.facts?.scenes.find(({ name }) => name === scene)?.player;
}

function events(copy) {
  for (let event = copy.pollEvent(); event !== undefined; event = copy.pollEvent()) {
    if (event.kind === "refused" || event.kind === "denied") hint(sentence(event.message));
    if (event.kind === "tierChanged" || event.kind === "subscriptionChanged") {
      const within = (event.to ?? event.stream)?.within;
      const length = typeof within === "object" ? within.position : within;
      if (length !== undefined) tolerance.show(length);
      figures.restartErrors();
    }
    if (event.kind === "sceneFaulted")
      notice("The scene stands still", "Its physics engine failed. Follow another scene.");
  }
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
  if (live?.copy !== undefined) showLive(now, seconds);
  if (mode.kind === "history") showPast(mode.past, now / 1000);
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
    const before = live?.copy?.statistics.receivedDatagrams;
    await new Promise((resolve) => setTimeout(resolve));
    if (live?.copy?.statistics.receivedDatagrams === before) return;
  }
}

function note(times, time) {
  times.push(time);
  if (times.length > FRAME_TIMES) times.shift();
}

/** Shows the copy, and the other picture if there is one; `now` in seconds. */
function showPictures({ frame, errors, judged, beside }, now) {
  showPanes(beside !== undefined);
  const picked = placeOfPicked(frame);
  pane.show(frame, { errors, judged, picked, now });
  if (beside === undefined) return;
  besidePane.show(beside.frame, { ...beside, picked: placeOfPicked(beside.frame), now });
}

/** Shows a place of the history, or a recording. */
function showPast(past, now) {
  const { frame, errors } = past;
  lastShown = frame;
  showPictures(past, now);
  if (panel.id !== undefined) panel.showFrame(frame, errors, placeOfPicked(frame), now);
  element("counts").textContent = `tick ${frame.time}, ${frame.layout.movable.length} bodies`;
}

/** Says what the colours mean: within which tolerance, and whether there is a truth to compare with. */
function legend(...of) {
  legendOf = of;
  showLegend(element("legend"), colours.legend(...of));
}

/** Shows one picture or two. */
function showPanes(areTwo) {
  const { pictures } = stage;
  if ((stage.shown.length === 2) === areTwo) return;
  stage.shown = areTwo ? pictures : [pane.picture];
  element("pictures").classList.toggle("two", areTwo);
}

/** The place of the picked body in a frame; negative if there is none. */
function placeOfPicked({ layout, positions }) {
  const place = panel.id === undefined ? -1 : (layout.places.get(panel.id) ?? -1);
  return positions[3 * place] === AWAY ? -1 : place;
}

/** Shows another body in the panel, or none. */
function pick(id) {
  panel.pick(id);
  for (const each of [pane, besidePane]) each.trail.clear();
}

// Time ---------------------------------------------------------------------------------------------------------------

/** Turns to another source of frames: live, the last minute, or a recording. */
function turnTo(next) {
  mode = next;
  document.body.dataset.mode = next.kind;
  for (const each of [pane, besidePane]) each.forget();
}

function toLive() {
  if (live === undefined) return;
  // The bodies of a recording are others.
  if (mode.kind === "recording") {
    pick(undefined);
    figures.restart();
  }
  view.interrupt();
  setDown([0, -1, 0]);
  turnTo({ kind: "live" });
  element("headline").hidden = false;
  element("notice").hidden = !noticed;
  element("live").textContent = "Pause";
  element("moment").textContent = "live";
}

function toHistory(index) {
  const { history } = view;
  if (history.length === 0) return;
  const place = Math.max(0, Math.min(history.length - 1, index));
  turnTo({ kind: "history", index: place, past: view.past(place) });
  element("live").textContent = "Back to live";
  scrub(place);
  const ago = history.at(history.length - 1) - history.at(place);
  element("moment").textContent = `${number(ago, 1)} s ago`;
}

/** Puts the scrubber at a place of the history. */
function scrub(place) {
  // A value beyond the greatest one would be cut.
  element("scrubber").max = Math.max(0, view.history.length - 1);
  element("scrubber").value = place;
}

function setDown(direction) {
  for (const each of [pane, besidePane]) each.bodies.down = direction;
}

function togglePause() {
  if (mode.kind === "recording") player.togglePause();
  else if (mode.kind === "live") toHistory(view.history.length - 1);
  else toLive();
}

function step(by) {
  if (mode.kind === "recording") player.step(by);
  else if (view !== undefined) toHistory((mode.index ?? view.history.length - 1) + by);
}

// Recordings ---------------------------------------------------------------------------------------------------------

function showRecording(elapsed, now) {
  const { recording } = player;
  const { seconds, frame, errors, worst, actual, bytes, naive, beside } = player.advance(elapsed);
  const judgedOf = (shown) => ({ shown, actual });
  const isBeside = element("beside").checked && beside !== undefined;
  const other = isBeside ? { ...beside, judged: judgedOf(beside.frame) } : undefined;
  showPast({ frame, errors, judged: errors && judgedOf(frame), beside: other }, now);
  if (live === undefined) element("live").textContent = player.isPaused ? "Continue" : "Pause";
  if (!recording.isCompared) return;
  const { tolerance } = recording;
  if (!figures.count({ now: seconds, bytes, naive, worst, besideWorst: beside.worst, tolerance })) return;
  const copy = recording.run.startsWith("rhumb") ? undefined : recording.run;
  headline.show({ sums: figures.sums, bodies: frame.layout.movable.length, tolerance, copy, moment: "recorded" });
}

/** A recording begins. */
function begun(recording) {
  pick(undefined);
  figures.restart();
  turnTo({ kind: "recording" });
  setDown(recording.gravity);
  element("headline").hidden = !recording.isCompared;
  if (live !== undefined) element("live").textContent = "Back to live";
  element("notice").hidden = true;
  hint(recording.title);
  legend(recording.tolerance, recording.isCompared);
  stage.look([18, 14, 22], [0, 2, 0]);
}

// Controls -----------------------------------------------------------------------------------------------------------

/** Controls of every page, also of one without a server. */
function controls() {
  onValue(element("colour"), (name) => {
    colours.mode = name;
    if (legendOf !== undefined) legend(...legendOf);
  });
  onValue(element("flashes"), (isOn) => (pane.pulses.isOn = besidePane.pulses.isOn = isOn));
  onValue(element("lines"), (isOn) => (pane.offsets.isOn = besidePane.offsets.isOn = isOn));
  onValue(element("shadows"), (isOn) => (stage.shadows = isOn));
  onChoice(element("beside"), (isOn) => {
    if (view !== undefined) view.isBeside = isOn;
    if (mode.kind === "history") toHistory(mode.index);
  });
  element("live").addEventListener("click", () => {
    if (live === undefined) togglePause();
    else if (mode.kind === "live") toHistory(view.history.length - 1);
    else toLive();
  });
  element("scrubber").addEventListener("input", ({ target }) => {
    if (mode.kind === "recording") player.scrub(Number(target.value) / 1000);
    else toHistory(Number(target.value));
  });
  keys(element("view"), keyActions(), {
    press: (code) => hands?.press(code) ?? false,
    release: (code) => hands?.release(code),
    releaseAll: () => hands?.releaseAll(),
  });
  pointers(element("view"), pointerActions());
}

/** Controls that need a server. */
function liveControls() {
  tolerance = new Tolerance(element, (length) => {
    live.options.tolerance = length;
    figures.restartErrors();
    if (live.copy?.state === "open") live.copy.changeStream({ within: length });
  });
  live.options.tolerance = address.tolerance ?? live.options.tolerance;
  tolerance.show(live.options.tolerance);
  const setDelay = (ticks) => {
    live.options.delayTicks = ticks;
    live.copy?.setDelayTicks(ticks);
    element("delay").value = ticks;
    element("delay-shown").textContent = `${ticks} ticks`;
  };
  element("delay").addEventListener("input", ({ target }) => setDelay(Number(target.value)));
  setDelay(live.options.delayTicks);
  const showMoment = (moment) => {
    element("delay").disabled = moment !== "predicted";
    figures.restartErrors();
  };
  onValue(element("shown"), showMoment);
  element("complete").addEventListener("click", () => choose(element("shown"), "complete"));
  onValue(element("policy"), (may) => live.copy?.setTierPolicy(may ? { upTo: 0.2 } : "never"));
  onChoice(element("scene"), (name) => {
    writeAddress({ scene: name });
    if (mode.kind === "recording") toLive();
    follow(name);
  });
  onValue(element("truth"), (isOn) => live.showTruth(isOn).catch((cause) => hint(cause.message)));
  element("throw").addEventListener("click", () => hands.throwBall());
  element("spawn").addEventListener("click", () => hands.dropBox());
  element("remove").addEventListener("click", removePicked);
}

/** Removes the picked body, or the last one that was added. The ids of a recording are not those of the scene. */
function removePicked() {
  if (mode.kind !== "recording") hands?.remove(panel.id);
}

function keyActions() {
  const click = (id) => () => element(id).click();
  return {
    KeyT: () => hands?.throwBall(),
    KeyN: () => hands?.dropBox(),
    Delete: removePicked,
    KeyP: togglePause,
    ArrowLeft: () => step(-1),
    ArrowRight: () => step(1),
    KeyC: () => choose(element("colour"), COLOURS[(COLOURS.indexOf(colours.mode) + 1) % COLOURS.length]),
    KeyG: click("lines"),
    KeyF: click("flashes"),
    KeyB: click("beside"),
    Escape: () => {
      if (mode.kind !== "live") toLive();
      pick(undefined);
    },
  };
}

function pointerActions() {
  const paneAt = (event) => (stage.pictureAt(event) === pane.picture ? pane : besidePane);
  return {
    carry(event) {
      const under = paneAt(event);
      if (mode.kind !== "live" || under !== pane) return false;
      const hit = pane.bodies.pick(stage.ray(event));
      const id = hit && live.copy?.view.ids[hit.place];
      if (id === undefined) return false;
      hands.carry(id, hit.point, event, pane.picture);
      return true;
    },
    move: (event) => hands?.move(event),
    drop() {
      if (hands?.carried === undefined) return false;
      hands.drop();
      return true;
    },
    pick(event) {
      const under = paneAt(event);
      const hit = under.bodies.pick(stage.ray(event));
      pick(hit && under.layout.ids[hit.place]);
      if (hit) element("body-panel").open = true;
    },
  };
}

start();
