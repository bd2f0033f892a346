// The graphs: what the connection costs and how wrong the copy is, four times a second.

import { Graph } from "./graph.js";

/** Bytes of one body at one tick in the naive form: its id and 13 numbers of four bytes. */
const NAIVE_BYTES = 56;
/** Seconds between points. */
const EVERY = 0.25;

const INK = { colour: "--accent" };
const LIMIT = { colour: "--faint", dashed: true };

export class Figures {
  #graphs = {};
  #shown = {};
  #last;
  #worst = 0;

  constructor(element) {
    const lines = {
      bytes: [INK, LIMIT],
      error: [INK, LIMIT],
      updates: [INK],
      link: [INK, { colour: "--warn", own: true }],
    };
    for (const [name, of] of Object.entries(lines)) {
      this.#graphs[name] = new Graph(element(`${name}-graph`), of);
      this.#shown[name] = element(`${name}-shown`);
    }
  }

  /** Forgets what was counted: the connection is another one. */
  restart() {
    this.#last = undefined;
    for (const graph of Object.values(this.#graphs)) graph.clear();
  }

  /** Counts a frame; draws if it is time. `now` in seconds. */
  count({ now, client, statistics, movable, comparison, tolerance }) {
    if (comparison !== undefined) this.#worst = Math.max(this.#worst, comparison.worst);
    if (this.#last !== undefined && now - this.#last.now < EVERY) return;
    const { receivedDatagramBytes, receivedControlBytes, updates, packets, missed, roundTrip } = statistics;
    const bytes = receivedDatagramBytes + receivedControlBytes;
    const last = this.#last;
    this.#last = { now, bytes, updates, packets, missed };
    if (last === undefined) return;
    const seconds = now - last.now;
    // The counts begin anew with another stream.
    const rate = (name) => Math.max(0, this.#last[name] - last[name]) / seconds;
    const naive = (movable * NAIVE_BYTES) / client.config.step;
    const expected = this.#last.packets + this.#last.missed - last.packets - last.missed;
    const lost = expected > 0 ? Math.max(0, this.#last.missed - last.missed) / expected : 0;
    const worst = comparison === undefined ? undefined : this.#worst;
    this.#worst = 0;
    this.#graphs.bytes.add(rate("bytes"), naive);
    this.#graphs.error.add(worst, tolerance);
    this.#graphs.updates.add(rate("updates"));
    this.#graphs.link.add(roundTrip, 100 * lost);
    for (const graph of Object.values(this.#graphs)) graph.draw();
    const times = rate("bytes") > 0 ? naive / rate("bytes") : Infinity;
    const less = times > 9999 ? "" : `, ${number(times, 0)} times less than naive`;
    this.#shown.bytes.textContent = `${bytesText(rate("bytes"))}${less}`;
    const within = tolerance === undefined ? "" : ` of ${metres(tolerance)}`;
    this.#shown.error.textContent = worst === undefined ? "no truth to compare with" : `${metres(worst)}${within}`;
    this.#shown.updates.textContent = number(rate("updates"), 0);
    this.#shown.link.textContent = `${number(roundTrip, 1)} ms, ${number(100 * lost, 1)} % lost`;
  }
}

export function number(value, digits) {
  return value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

export function metres(length) {
  if (length >= 1) return `${number(length, 2)} m`;
  if (length >= 0.1) return `${number(100 * length, 1)} cm`;
  return `${number(1000 * length, 1)} mm`;
}

function bytesText(bytes) {
  return bytes < 1e4 ? `${number(bytes, 0)} B` : `${number(bytes / 1000, 1)} kB`;
}
