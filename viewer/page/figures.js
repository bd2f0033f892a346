// The figures, four times a second: graphs of what the copy costs and how wrong it is, and the sums for the two large numbers.

import { Graph } from "./graph.js";
import { byteRate, metres, number, shortMetres } from "./text.js";

/** Seconds between points, and points that are summed: a minute. */
const EVERY = 0.25;
const SUMMED = 240;
/** Points of the greatest error that is stated: a second. */
const GREATEST = 4;

const INK = { colour: "--accent" };
const LIMIT = { colour: "--faint", dashed: true };
const short = (value) => byteRate(value).replace(".0", "").replace(".00", "");

export class Figures {
  #graphs = {};
  #shown = {};
  #last;
  #worst = {};
  #points = [];

  constructor(element) {
    const length = { text: shortMetres };
    const graphs = {
      bytes: [[INK, LIMIT], { text: short, isLogarithmic: true }],
      error: [[INK, LIMIT], length],
      updates: [[INK], { text: (value) => number(value, value < 2 ? 1 : 0) }],
      link: [
        [INK, { colour: "--warn", own: true }],
        { text: (value) => `${number(value, value < 2 ? 1 : 0)} ms`, ownText: (value) => `${number(value, value < 2 ? 1 : 0)} %` },
      ],
    };
    for (const [name, [lines, options]] of Object.entries(graphs)) {
      this.#graphs[name] = new Graph(element(`${name}-graph`), lines, options);
      this.#shown[name] = element(`${name}-shown`);
    }
  }

  /** Forgets what was counted: the source is another one. */
  restart() {
    this.#last = undefined;
    this.#points = [];
    this.#worst = {};
    for (const graph of Object.values(this.#graphs)) graph.clear();
  }

  /** Forgets the greatest errors: what is shown is another moment, or within another tolerance. */
  restartErrors() {
    this.#worst = {};
    for (const point of this.#points) point.worst = point.besideWorst = undefined;
  }

  /**
   * Counts a frame: seconds (`now`), counts since the beginning (`bytes`, `naive` bytes, `updates`, `packets`, `missed`), and
   * present values (`roundTrip`, `worst` error, `besideWorst` of full states, `tolerance`). Draws and returns true if it is time.
   */
  count(sample) {
    for (const name of ["worst", "besideWorst"]) {
      if (sample[name] !== undefined) this.#worst[name] = Math.max(this.#worst[name] ?? 0, sample[name]);
    }
    const last = this.#last;
    if (last !== undefined && sample.now >= last.now && sample.now - last.now < EVERY) return false;
    this.#last = sample;
    if (last === undefined || sample.now < last.now) return false;
    const seconds = sample.now - last.now;
    // The counts begin anew with another stream.
    const grown = (name) => Math.max(0, (sample[name] ?? 0) - (last[name] ?? 0));
    const { worst, besideWorst } = this.#worst;
    const { tolerance, roundTrip } = sample;
    this.#worst = {};
    this.#points.push({ seconds, bytes: grown("bytes"), naive: grown("naive"), worst, besideWorst });
    if (this.#points.length > SUMMED) this.#points.shift();
    const expected = grown("packets") + grown("missed");
    const lost = expected > 0 ? (100 * grown("missed")) / expected : 0;
    this.#graphs.bytes.add(grown("bytes") / seconds, grown("naive") / seconds);
    this.#graphs.error.add(worst, tolerance);
    this.#graphs.updates.add(grown("updates") / seconds);
    this.#graphs.link.add(roundTrip, lost);
    for (const graph of Object.values(this.#graphs)) graph.draw();
    this.#shown.bytes.textContent = byteRate(grown("bytes") / seconds);
    const within = tolerance > 0 ? ` of ${shortMetres(tolerance)}` : "";
    this.#shown.error.textContent = worst === undefined ? "no truth to compare with" : `${metres(worst)}${within}`;
    this.#shown.updates.textContent = number(grown("updates") / seconds, 0);
    this.#shown.link.textContent = roundTrip === undefined ? "" : `${number(roundTrip, 1)} ms, ${number(lost, 1)} % lost`;
    return true;
  }

  /**
   * Means over the last minute, or since the beginning: `bytes` a second, and `naive`, what full states of all bodies at every
   * tick take; the greatest errors of the last second (`worst`, `besideWorst`).
   */
  get sums() {
    const sum = (name) => this.#points.reduce((total, point) => total + point[name], 0);
    const greatest = (name) => {
      const known = this.#points.slice(-GREATEST).map((point) => point[name]).filter(Number.isFinite);
      return known.length > 0 ? Math.max(...known) : undefined;
    };
    const seconds = sum("seconds");
    return {
      seconds,
      bytes: sum("bytes") / seconds,
      naive: sum("naive") / seconds,
      worst: greatest("worst"),
      besideWorst: greatest("besideWorst"),
    };
  }
}
