// A member of a scene over a connection: moves bytes between the two, and continues over another connection when one ends.

import { Connection, placeOf, within } from "./connection.js";
import { RhumbError, wrong } from "./error.js";
import { Member } from "./member.js";

/** Events kept until they are read; beyond them the oldest are dropped. */
const EVENTS_KEPT = 65536;
/** Refusals kept until a call throws them; of further ones only the number is known. */
const REFUSALS_KEPT = 1024;
/** First and longest pause between attempts to reach the server again, and the time of one, milliseconds. */
const PAUSE_FIRST = 100;
const PAUSE_MAX = 5000;
const ATTEMPT = 3000;
/** Time of one attempt at a server that another one has named: it may have ended since. Milliseconds. */
const ATTEMPT_ELSEWHERE = 1000;
/** Servers that are asked for a scene, each named by the one before, before there is a pause. */
const FOLLOWED_MAX = 8;
/** How far the moment of a poll may be from the clock: a page may have stood still within a frame. Milliseconds. */
const CLOCK_APART_MAX = 10000;
/** The code of a close for lack of a place. */
const BUSY = 7;
/** The close code of a server that does not have the scene, and has named the one that has it. */
const ELSEWHERE = 11;
/** Denials by the calls that they answer; one of a stream or of more ids answers none of these. */
const DENIALS = {
  inspected: ["noSuchScene", "other"],
  deleted: ["noSuchScene", "owned", "notAllowed", "other"],
  ticks: ["notLockstep", "tooFarAhead", "advanceNotAllowed", "sceneFaulted", "owned", "other"],
};

const COUNTERS = [
  "receivedDatagrams",
  "receivedDatagramBytes",
  "receivedControlBytes",
  "sentDatagrams",
  "sentDatagramBytes",
  "sentControlBytes",
];

/** True if refusals are only events. */
function quiet(refusals = "throw") {
  if (refusals !== "throw" && refusals !== "events") {
    throw wrong("options.join.refusals", refusals, `"throw" or "events"`);
  }
  return refusals === "events";
}

const now = () => performance.now();

const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

export class Client {
  #member;
  /** Makes the member of a client that has not joined yet. */
  #newMember;
  #connection;
  #connecting;
  /** Servers in a row that have named another one. */
  #followed = 0;
  #events = [];
  /** Unread events that were dropped, the oldest first. */
  #eventsLeftOut = 0;
  /** Refusals that no call has thrown yet; undefined if they are events alone. */
  #refused = [];
  #refusedMore = 0;
  #timer;
  #flushing = false;
  #state = "open";
  #ending;
  /** Why the scene has stopped. */
  #fault;
  #interruptedAt;
  #resumeWithin;
  /** The last interruption: its `error`, and the moment `until` which the client tries to resume. */
  #interruption;
  #tap;
  #counted = Object.fromEntries(COUNTERS.map((counter) => [counter, 0]));
  /** Calls that wait: for `joined`, `inspected`, `deleted`, and ticks. */
  #waiting = { joined: [], inspected: [], deleted: [], ticks: [] };
  #settleClosed;
  scene;
  config;
  closed = new Promise((resolve) => (this.#settleClosed = resolve));

  /** Joins over an open connection. `connecting` opens another one. */
  static async join(connection, connecting, scene, options) {
    const client = new Client();
    // The others are the member's, which refuses those that it does not know.
    const { refusals, resumeWithin, record, ...join } = options;
    if (resumeWithin !== undefined && !(resumeWithin >= 0 && resumeWithin < Infinity)) {
      throw wrong("options.join.resumeWithin", resumeWithin, "seconds, finite and not negative");
    }
    client.record(record);
    const seed = resumeWithin === 0 ? undefined : crypto.getRandomValues(new Uint8Array(16));
    client.scene = scene;
    client.#connecting = connecting;
    client.#resumeWithin = resumeWithin;
    client.#refused = quiet(refusals) ? undefined : [];
    client.#newMember = () => new Member(scene, { token: connecting.token, join, seed });
    client.#member = client.#newMember();
    const joined = new Promise((resolve, reject) => client.#waiting.joined.push({ resolve, reject }));
    client.#attach(connection);
    try {
      await within(joined, connecting.timeout, "scene", connecting.signal);
    } catch (cause) {
      client.close();
      throw cause;
    }
    client.config = client.#member.config;
    return client;
  }

  #attach(connection) {
    this.#connection = connection;
    this.#member.handleOpened(now());
    this.#drain();
    connection.start({
      control: (bytes) => {
        this.#tap?.("controlDown", bytes);
        this.#member.handleControl(now(), bytes);
        this.#drain();
      },
      datagram: (bytes) => {
        this.#tap?.("stateDown", bytes);
        this.#member.handleDatagram(now(), bytes);
        this.#drain();
      },
      ended: (closeCode) => {
        this.#member.handleEnded(now(), closeCode);
        this.#drain();
      },
    });
  }

  /** Sends what the session has queued, takes its events, and sets its timer. */
  #drain() {
    if (this.#state === "ended") return;
    for (let sent = this.#member.pollTransmit(); sent !== undefined; sent = this.#member.pollTransmit()) {
      if (sent.kind === "control") {
        this.#tap?.("controlUp", sent.bytes);
        this.#connection?.sendControl(sent.bytes);
      } else if (sent.kind === "state") {
        this.#tap?.("stateUp", sent.bytes);
        this.#connection?.sendDatagram(sent.bytes);
      } else {
        this.#connection?.close(sent.code);
      }
    }
    for (let event = this.#member.pollEvent(); event !== undefined; event = this.#member.pollEvent()) {
      this.#take(event);
    }
    this.#settleTicks();
    this.#setTimer();
  }

  #setTimer() {
    clearTimeout(this.#timer);
    if (this.#state === "resuming" && this.#connection !== undefined) {
      // A server may take the connection and never answer.
      const { until, error } = this.#interruption;
      this.#timer = setTimeout(
        () => {
          this.#connection?.close(0);
          this.#end(error);
        },
        Math.max(0, until - now()),
      );
    }
    if (this.#state !== "open") return;
    const at = this.#member.pollTimeout();
    if (at === undefined) return;
    this.#timer = setTimeout(
      () => {
        this.#member.handleTimeout(now());
        this.#drain();
      },
      Math.max(0, at - now()),
    );
  }

  #take(event) {
    switch (event.kind) {
      case "joined":
        return this.#resolve("joined");
      case "joinFailed":
        return this.#reject("joined", new RhumbError(event.error));
      case "inspected":
        return this.#resolve("inspected", event.inspection);
      case "deleted":
        this.#push(event);
        return this.#handleDeleted();
      case "sceneFaulted":
        this.#handleFault(event);
        break;
      case "refused":
      case "authorityDenied":
        this.#refuse(event);
        break;
      case "denied":
        this.#deny(event);
        break;
      case "resumed":
        // A server takes no member back into a scene that stands still.
        this.#fault = undefined;
        this.#state = "open";
        this.#interruptedAt = undefined;
        break;
      case "ended":
        return this.#handleEnded(event);
    }
    this.#push(event);
  }

  #push(event) {
    if (this.#events.length === EVENTS_KEPT) {
      this.#events.shift();
      this.#eventsLeftOut += 1;
    }
    this.#events.push(event);
  }

  /** The membership ended with the scene. */
  #handleDeleted() {
    this.#resolve("deleted");
    this.#connection?.close(0);
    this.#end(new RhumbError({ code: "sceneDeleted", message: "the scene was deleted" }));
  }

  #handleFault({ tick }) {
    const message = `the scene's engine failed; it stands still after tick ${tick}`;
    this.#fault = new RhumbError({ code: "sceneFaulted", message });
    this.#settleTicks();
    this.#rejectTicks(this.#fault);
  }

  #handleEnded({ code, message, closeCode, mayResume, complete, elsewhere }) {
    this.#count();
    this.#connection = undefined;
    const error = new RhumbError({ code, message, closeCode });
    const named = placeOf(elsewhere);
    // The end of a connection may overtake the address: then the server is asked again.
    const isElsewhere = named !== undefined || closeCode === ELSEWHERE;
    const mayFollow = this.#followed < FOLLOWED_MAX;
    this.#followed = isElsewhere && mayFollow ? this.#followed + 1 : 0;
    const place = mayFollow ? named : undefined;
    if (this.#state === "open" && isElsewhere && (named !== undefined || mayFollow) && !this.#member.joined) {
      this.#member.free();
      this.#member = this.#newMember();
      this.#reach(place, PAUSE_FIRST);
      return;
    }
    this.#interruptedAt ??= now();
    const within = this.#resumeWithin === undefined ? this.#member.resumeWithin : this.#resumeWithin * 1000;
    const until = this.#interruptedAt + within;
    if (this.#state !== "ended" && mayResume && now() < until) {
      if (this.#state === "open") this.#push({ kind: "interrupted", message, complete });
      this.#state = "resuming";
      this.#interruption = { until, error };
      this.#member.reconnect();
      // A scene that had no place for this client is asked ever more rarely.
      const fullFor = closeCode === BUSY ? now() - this.#interruptedAt : 0;
      this.#reach(place, Math.min(Math.max(PAUSE_FIRST, fullFor / 2), PAUSE_MAX), { until, error });
    } else {
      this.#end(error);
    }
  }

  /**
   * Tries to reach a server again: at once the one that the last one has named, otherwise the one of this client, after pauses
   * that double and are shortened at random. Without a limit, until the client ends.
   */
  async #reach(place, longest, { until = Infinity, error } = {}) {
    const before = this.#state;
    for (; ; place = undefined) {
      if (place === undefined) {
        await pause(longest * (0.5 + Math.random() / 2));
        longest = Math.min(2 * longest, PAUSE_MAX);
      }
      if (this.#state !== before) return;
      if (now() >= until) return this.#end(error);
      const { url, print } = place ?? this.#connecting;
      const timeout = place === undefined ? ATTEMPT : ATTEMPT_ELSEWHERE;
      try {
        const options = { ...this.#connecting.options, print, timeout, signal: undefined };
        const connection = await Connection.open(url, options);
        if (this.#state !== before) return connection.close(0);
        return this.#attach(connection);
      } catch {
        // The next attempt may find the server.
      }
    }
  }

  #end(error) {
    if (this.#state === "ended") return;
    this.#state = "ended";
    this.#ending = error;
    clearTimeout(this.#timer);
    this.#push({ kind: "ended", error, complete: this.#member.completeTick });
    for (const waiting of Object.keys(this.#waiting)) this.#reject(waiting, error);
    this.#settleClosed(error);
  }

  #resolve(waiting, value) {
    for (const { resolve } of this.#waiting[waiting].splice(0)) resolve(value);
  }

  #reject(waiting, error) {
    for (const { reject } of this.#waiting[waiting].splice(0)) reject(error);
  }

  /** Keeps a refusal for the next call that computes the view. An authority that lost sync is requested again. */
  #refuse({ number, body, reason, message }) {
    if (reason === undefined || !this.#refused) return;
    if (this.#refused.length < REFUSALS_KEPT) this.#refused.push({ number, body: body ?? undefined, reason, message });
    else this.#refusedMore += 1;
  }

  /** Throws what the server has refused since the last call that threw. */
  #throwRefusals() {
    if (!this.#refused?.length) return;
    const refusals = this.#refused.splice(0);
    const refusalsLeftOut = this.#refusedMore;
    this.#refusedMore = 0;
    const [{ number, body, message }] = refusals;
    const what = number === undefined ? "the authority" : `command ${number}`;
    const about = body === undefined ? "" : ` about body ${body}`;
    const others = refusals.length - 1 + refusalsLeftOut;
    const more = others > 0 ? ` (and ${others} more refusals)` : "";
    const text = `the server refused ${what}${about}: ${message}${more}`;
    throw new RhumbError({ code: "refused", message: text, refusals, refusalsLeftOut });
  }

  /** A denial answers the calls that wait, if it is of their kind. */
  #deny({ denial, message }) {
    const error = new RhumbError({ code: "denied", message, denial });
    for (const waiting of ["inspected", "deleted"]) {
      if (DENIALS[waiting].includes(denial)) this.#reject(waiting, error);
    }
    if (DENIALS.ticks.includes(denial)) this.#rejectTicks(error);
  }

  /** The scene will not step as far as was requested. */
  #rejectTicks(error) {
    if (this.#waiting.ticks.length > 0) this.#member.giveUpAdvance();
    this.#reject("ticks", error);
  }

  #settleTicks() {
    if (this.#waiting.ticks.length === 0) return;
    // The answers to commands come beside the tick, and may be the later ones.
    if (this.#member.awaitsAnswers) return;
    const complete = this.#member.completeTick;
    const { ticks } = this.#waiting;
    this.#waiting.ticks = ticks.filter(({ wanted }) => wanted > complete);
    for (const { wanted, resolve } of ticks) if (wanted <= complete) resolve(complete);
  }

  #wait(waiting, more) {
    return new Promise((resolve, reject) => this.#waiting[waiting].push({ resolve, reject, ...more }));
  }

  /** Limits the time of an answer; a connection that is sought anew has a limit of its own. */
  async #answered(promise, awaited) {
    for (;;) {
      try {
        return await within(promise, this.#connecting.timeout, awaited);
      } catch (cause) {
        if (cause.code !== "timeout" || this.#state !== "resuming") throw cause;
      }
    }
  }

  /** Sends what a call has queued, once the calls of this task are over. */
  #flushSoon() {
    if (this.#flushing) return;
    this.#flushing = true;
    queueMicrotask(() => {
      this.#flushing = false;
      this.#drain();
    });
  }

  /** A client that has ended takes no calls. */
  #check() {
    if (this.#state === "ended") throw this.#ending;
  }

  #open() {
    this.#check();
    this.#flushSoon();
    return this.#member;
  }

  #count() {
    const counters = this.#connection?.counters;
    if (counters === undefined) return;
    for (const counter of COUNTERS) this.#counted[counter] += counters[counter];
  }

  get state() {
    return this.#state;
  }

  get ending() {
    return this.#ending;
  }

  poll(at = now()) {
    this.#check();
    // A moment of another clock would put the session's out for good.
    if (!Number.isFinite(at) || Math.abs(at - now()) > CLOCK_APART_MAX) {
      throw wrong("now", at, `within ${CLOCK_APART_MAX / 1000} s of performance.now(), which is ${now()}`);
    }
    const shown = this.#member.poll(Math.min(at, now()));
    // To ask for bounds asks the server, too.
    if (this.#state === "open") this.#drain();
    this.#throwRefusals();
    return shown;
  }

  show(ticks) {
    this.#check();
    this.#member.show(ticks, now());
  }

  async advance() {
    const member = this.#open();
    if (this.#fault !== undefined) throw this.#fault;
    const wanted = member.advance(now());
    const tick = await this.#answered(this.#wait("ticks", { wanted }), `tick ${wanted}`);
    this.show(tick);
    this.#throwRefusals();
    return tick;
  }

  get view() {
    return this.#member.view;
  }

  get completeTick() {
    return this.#member.completeTick;
  }

  get stream() {
    return this.#member.stream;
  }

  get tolerance() {
    return this.stream?.within;
  }

  changeStream(choice) {
    this.#open().changeStream(choice);
  }

  get cellGrid() {
    return this.#member.cellGrid;
  }

  get cells() {
    return this.#member.cells;
  }

  takeCells(cells) {
    this.#open().takeCells(cells);
  }

  takeCellsAround(point, bands) {
    this.#open().takeCellsAround(point, bands);
  }

  setTierPolicy(policy) {
    this.#open().setTierPolicy(policy);
  }

  setDelayTicks(ticks) {
    this.#check();
    this.#member.setDelayTicks(ticks);
  }

  setLeadTicks(ticks) {
    this.#check();
    this.#member.setLeadTicks(ticks);
  }

  setSmooth(smooth) {
    this.#check();
    this.#member.setSmooth(smooth);
  }

  pollEvent() {
    return this.#events.shift();
  }

  get gravity() {
    return this.#member.gravity;
  }

  body(id) {
    return this.#member.body(id);
  }

  shape(id) {
    return this.#member.shape(id);
  }

  joints() {
    return this.#member.joints();
  }

  track(id) {
    return this.#member.track(id);
  }

  errorBound(id) {
    return this.#member.errorBound(id);
  }

  tickErrorBound(id, tick) {
    return this.#member.tickErrorBound(id, tick);
  }

  get digest() {
    return this.#member.digest;
  }

  addBody(body) {
    return this.addBodies([body])[0];
  }

  addBodies(bodies) {
    return this.#open().addBodies(bodies);
  }

  command(command) {
    return this.#open().command(command);
  }

  removeUnusedShapes() {
    return this.#open().removeUnusedShapes();
  }

  query(queries) {
    return this.#open().query(queries);
  }

  flush() {
    this.#drain();
  }

  takeAuthority(bodies, tolerance) {
    this.#open().takeAuthority(bodies, tolerance);
  }

  get authorityBodies() {
    return this.#member.authorityBodies;
  }

  publish(states) {
    return this.#open().publish(now(), states);
  }

  async inspect() {
    this.#open().inspect();
    return this.#answered(this.#wait("inspected"), "inspection");
  }

  async delete() {
    this.#open().delete();
    return this.#answered(this.#wait("deleted"), "answer");
  }

  get statistics() {
    const counters = this.#connection?.counters ?? {};
    const sums = COUNTERS.map((counter) => [counter, this.#counted[counter] + (counters[counter] ?? 0)]);
    return { ...Object.fromEntries(sums), eventsLeftOut: this.#eventsLeftOut, ...this.#member.statistics(now()) };
  }

  record(tap) {
    if (tap !== undefined && typeof tap !== "function") throw wrong("record", tap, "a function, or undefined");
    this.#tap = tap;
  }

  close() {
    if (this.#state === "ended") return;
    this.#member.close();
    this.#drain();
    const error = new RhumbError({ code: "closed", message: "this client has left", closeCode: 0 });
    this.#end(error);
  }
}
