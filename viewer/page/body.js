// The panel of one body: its track, its predictor, its error, and its last updates.

import { Graph } from "./graph.js";
import { metres, number, shortMetres } from "./text.js";

const UPDATES_SHOWN = 8;
const KINDS = ["fixed", "dynamic", "kinematic"];
const PREDICTORS = {
  rest: "at rest",
  uniform: "uniform motion",
  ballistic: "ballistic",
  torqueFree: "torque-free rotation",
  ballisticTorqueFree: "ballistic, torque-free rotation",
  accelerated: "constant acceleration",
};

export class BodyPanel {
  #facts;
  #hint;
  #list;
  #graphCanvas;
  #graph;
  #updates = [];
  #origin;
  #drawn = 0;
  /** The body's id; undefined if none is picked. */
  id;

  constructor(element) {
    this.#facts = element("body-facts");
    this.#hint = element("body-hint");
    this.#list = element("body-updates");
    this.#graphCanvas = element("body-graph");
    this.#graph = new Graph(this.#graphCanvas, [{ colour: "--accent" }, { colour: "--faint", dashed: true }], {
      text: shortMetres,
    });
  }

  pick(id) {
    this.id = id;
    this.#updates = [];
    this.#origin = undefined;
    this.#graph.clear();
    this.#hint.hidden = id !== undefined;
    this.#graphCanvas.hidden = id === undefined;
    this.#facts.replaceChildren();
    this.#list.replaceChildren();
  }

  /** Shows the body in a live frame. Reads the client, so that the frame's columns end. */
  show(client, { place, error, time, tolerance, bound, now }) {
    const track = client.track(this.id);
    if (track === undefined || place < 0) return this.#write([["body", `${this.#name()} has left the scene`]]);
    if (track.origin !== this.#origin) {
      if (this.#origin !== undefined) this.#note(track);
      this.#origin = track.origin;
    }
    if (!this.#isDue(now)) return;
    this.#graph.add(error, tolerance);
    this.#graph.draw();
    const { position, linearVelocity, angularVelocity } = track.state;
    const desc = client.body(this.id);
    this.#write([
      ["body", `${this.#name()}, ${desc.kind}, ${client.shape(desc.shape)?.kind ?? "no shape"}`],
      ["predictor", PREDICTORS[track.predictor] ?? track.predictor],
      [
        "track from",
        `tick ${track.origin}, ${Math.max(0, Math.round(time - track.origin))} ticks ago${track.exact ? ", exact" : ""}`,
      ],
      ["position then", vector(position, "m")],
      ["velocity then", vector(linearVelocity ?? [0, 0, 0], "m/s")],
      ["spin then", vector(angularVelocity ?? [0, 0, 0], "rad/s")],
      ["error now", error === undefined ? "no truth to compare with" : metres(error)],
      ["tolerance", metres(tolerance)],
      ["stated bound", Number.isFinite(bound) ? metres(bound) : "unknown: a packet is missing"],
    ]);
  }

  /** Shows the body in a frame of the last minute or of a recording. */
  showFrame({ layout, positions, resting, tolerances }, errors, place, now) {
    // Updates that come meanwhile are not listed.
    this.#origin = undefined;
    if (!this.#isDue(now)) return;
    if (place < 0) return this.#write([["body", `${this.#name()} is not in the scene`]]);
    const { kinds, shapeNumbers, shapesByNumber } = layout;
    const rows = [
      ["body", `${this.#name()}, ${KINDS[kinds[place]]}, ${shapesByNumber.get(shapeNumbers[place])?.kind ?? "no shape"}`],
      ["position", vector(Array.from(positions.subarray(3 * place, 3 * place + 3)), "m")],
      ["moves", resting[place] === 1 ? "no" : "yes"],
    ];
    if (Number.isFinite(errors?.[place])) rows.push(["error", metres(errors[place])]);
    if (tolerances[place] > 0) rows.push(["tolerance", metres(tolerances[place])]);
    this.#write(rows);
  }

  #isDue(now) {
    if (now - this.#drawn < 0.1) return false;
    this.#drawn = now;
    return true;
  }

  #name() {
    return `${this.id % 2 ** 32}${this.id >= 2 ** 32 ? ` (generation ${Math.floor(this.id / 2 ** 32)})` : ""}`;
  }

  #note({ origin, predictor }) {
    const since = origin - this.#origin;
    this.#updates.unshift(`tick ${origin}, after ${since}: ${PREDICTORS[predictor] ?? predictor}`);
    this.#updates.length = Math.min(this.#updates.length, UPDATES_SHOWN);
    this.#list.replaceChildren(
      ...this.#updates.map((text) => {
        const item = document.createElement("li");
        item.textContent = text;
        return item;
      }),
    );
  }

  #write(rows) {
    this.#facts.replaceChildren(
      ...rows.flatMap(([name, text]) => {
        const term = document.createElement("dt");
        const description = document.createElement("dd");
        term.textContent = name;
        description.textContent = text;
        return [term, description];
      }),
    );
  }
}

function vector(parts, unit) {
  return `${parts.map((part) => number(part, 2)).join(", ")} ${unit}`;
}
