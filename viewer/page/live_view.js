// The live picture: the copy at the chosen moment with its errors, and beside it full states at the same bytes.

import { Beside } from "./beside.js";
import { Comparison } from "./comparison.js";
import { frameOf } from "./frame.js";
import { History } from "./history.js";
import { rosterOf } from "./roster.js";
import { STATE_BYTES } from "./sender.js";

/** Columns that every picture needs, and those of bodies that are judged. */
const SHOWN = ["updateTicks"];
const JUDGED = [...SHOWN, "errorBounds", "tolerances"];

export class LiveView {
  #live;
  #layout;
  #source;
  #beside = new Beside();
  /** Bytes that full states of all bodies would have taken, up to the tick of the last frame. */
  #naive = 0;
  #time;
  /** True if the other picture is computed. */
  isBeside = true;
  comparison = new Comparison();
  /** The last minute of both pictures. */
  history = new History();
  besideHistory = new History();

  constructor(live) {
    this.#live = live;
  }

  /** The copy is another one. */
  restart() {
    this.#layout = this.#time = undefined;
    this.#naive = 0;
    this.#beside = new Beside();
    this.comparison.restart();
    this.history.clear();
    this.besideHistory.clear();
  }

  /** Frames that follow are not added to the last minute: the next ones are whole. */
  interrupt() {
    this.history.interrupt();
    this.besideHistory.interrupt();
  }

  /**
   * Reads the copy at the chosen moment; `now` in milliseconds. Its columns, in `frame`, end with the next call of the copy; with
   * tolerances and bounds where there is a truth, or if a body is picked (`isPicked`). `errors` and `judged`, a tick with its
   * truth, where it is compared; `beside`, the other picture.
   */
  read(now, moment, isPicked) {
    const { copy, truth } = this.#live;
    const statistics = copy.statistics;
    const time = showMoment(copy, now, moment, statistics);
    this.#readLayout(copy);
    truth?.read();
    const columns = truth !== undefined || isPicked ? JUDGED : SHOWN;
    const frame = { ...frameOf(copy.view, columns), layout: this.#layout };
    this.#countNaive(time);
    if (truth === undefined) return { time, frame, statistics, naive: this.#naive };
    const { comparison } = this;
    comparison.show(frame, this.#layout, time <= statistics.completeTick);
    comparison.settle(truth);
    const isJudged = comparison.layout === this.#layout;
    return {
      time,
      frame,
      statistics,
      naive: this.#naive,
      errors: isJudged ? comparison.errors : undefined,
      judged: isJudged ? comparison : undefined,
      worst: isCounted(comparison, moment) ? comparison.worst : undefined,
      tolerance: comparison.tolerance,
      beside: this.isBeside ? this.#besideOf(truth, time, statistics) : undefined,
    };
  }

  #readLayout(copy) {
    if (this.#layout?.generation === copy.view.generation && this.#source === copy) return;
    this.#source = copy;
    this.#layout = rosterOf(frameOf(copy.view), copy);
  }

  /** Full states of all bodies that can move, at each tick. */
  #countNaive(time) {
    const ticks = Math.max(0, time - (this.#time ?? time));
    this.#time = time;
    this.#naive += ticks * this.#layout.movable.length * STATE_BYTES;
  }

  #besideOf(truth, time, { receivedDatagramBytes, receivedControlBytes }) {
    const beside = this.#beside;
    beside.follow(truth, time, receivedDatagramBytes + receivedControlBytes);
    const frame = beside.frame(this.comparison.tolerance);
    if (frame === undefined) return undefined;
    return { frame, errors: beside.errors, worst: beside.worst, judged: { shown: frame, actual: beside.actual } };
  }

  /** Keeps a frame that was shown in the last minute; `now` in seconds. */
  keep({ frame, errors, beside }, now) {
    this.history.add(frame, errors, now);
    if (beside !== undefined) this.besideHistory.add({ ...beside.frame, changed: this.#beside.touched }, beside.errors, now);
  }

  /** The pictures of a place of the history. */
  past(index) {
    const frame = this.history.frame(index);
    const besideFrame = this.#besideAt(this.history.at(index));
    const judgedOf = (shown) => ({ shown, actual: this.#live.truth?.at(shown.time) });
    return {
      frame,
      errors: frame.errors,
      judged: judgedOf(frame),
      beside: besideFrame && { frame: besideFrame, errors: besideFrame.errors, judged: judgedOf(besideFrame) },
    };
  }

  #besideAt(at) {
    const { besideHistory } = this;
    return this.isBeside && besideHistory.length > 0 ? besideHistory.frame(besideHistory.indexAt(at)) : undefined;
  }
}

/** True if the last compared tick is one of the chosen moment: a view that was ahead waits until complete ticks have come up. */
function isCounted({ tick, isComplete }, moment) {
  return tick >= 0 && (moment !== "complete" || isComplete);
}

/** Computes the copy's view of the chosen moment; returns the moment. */
function showMoment(copy, now, moment, { completeTick, watermarkTick }) {
  if (moment === "predicted") return copy.poll(now);
  // A view does not go back.
  const time = Math.max(moment === "complete" ? completeTick : watermarkTick, copy.view.time);
  copy.show(time);
  return time;
}
