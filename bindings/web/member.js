// A member of a scene without socket or clock, and its view: a thin cover of the module's functions.

import { answer, found, give, giveBytes, module, numbers, output, outputBytes } from "./module.js";
import { RhumbError, wrong } from "./error.js";

const IDS = 0;
const SHAPES = 1;
const KINDS = 2;
const RESTING = 3;
const CHANGED = 4;
const REMOVED = 5;
const UPDATE_TICKS = 6;
const ERROR_BOUNDS = 7;
const TOLERANCES = 8;
const POSITIONS = 9;
const ROTATIONS = 10;
const LINEAR_VELOCITIES = 11;
const ANGULAR_VELOCITIES = 12;

const JOINTS = 0;
const CONFIG = 1;
const STREAM = 2;
const GRAVITY = 3;
const DIGEST = 4;
const AUTHORITY = 5;
const CELL_GRID = 6;
const CELLS = 7;

const DELAY = 0;
const LEAD = 1;
const SMOOTH = 2;

/** The poses of all bodies at one moment. Its arrays are valid until the next call of the member. */
class View {
  /** Asks the member for its handle, which another one may have once it was freed. It also keeps the member. */
  #handle;
  time = 0;

  constructor(handle) {
    this.#handle = handle;
  }

  get count() {
    return module().count(this.#handle());
  }

  get generation() {
    return module().generation(this.#handle());
  }

  #column(column, Type, each = 1) {
    // The call may compute the column, so the place is asked for first.
    const place = module().column(this.#handle(), column);
    return numbers(Type, place, module().column_entries(this.#handle(), column) * each);
  }

  get ids() {
    return this.#column(IDS, Float64Array);
  }

  get shapes() {
    return this.#column(SHAPES, Uint32Array);
  }

  get kinds() {
    return this.#column(KINDS, Uint8Array);
  }

  get positions() {
    return this.#column(POSITIONS, Float32Array, 3);
  }

  get rotations() {
    return this.#column(ROTATIONS, Float32Array, 4);
  }

  get linearVelocities() {
    return this.#column(LINEAR_VELOCITIES, Float32Array, 3);
  }

  get angularVelocities() {
    return this.#column(ANGULAR_VELOCITIES, Float32Array, 3);
  }

  get resting() {
    return this.#column(RESTING, Uint8Array);
  }

  get changed() {
    return this.#column(CHANGED, Uint32Array);
  }

  get removed() {
    return this.#column(REMOVED, Float64Array);
  }

  get updateTicks() {
    return this.#column(UPDATE_TICKS, Float64Array);
  }

  get errorBounds() {
    return this.#column(ERROR_BOUNDS, Float32Array);
  }

  get tolerances() {
    return this.#column(TOLERANCES, Float32Array);
  }

  place(id) {
    const place = module().place(this.#handle(), bodyOf(id));
    return place < 0 ? undefined : place;
  }
}

/** WebAssembly would take null for the number zero. */
const bodyOf = (id) => (typeof id === "number" ? id : NaN);

function number(what, value) {
  if (typeof value !== "number") throw wrong(what, value, "a number");
  return value;
}

/** Milliseconds of a clock. */
function moment(now) {
  if (!Number.isFinite(now) || now < 0) throw wrong("now", now, "milliseconds of a clock, finite and not negative");
  return now;
}

function hexadecimal(bytes) {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Frees the module's memory of members that nothing refers to: a page that connects again and again needs no more of it. */
const members = new FinalizationRegistry((handle) => module().member_free(handle));

/** The Member of `rhumb.d.ts`, with more that a client needs. */
export class Member {
  /** The module's number of this member; 0 after it was freed. */
  #number;
  #events = [];
  #joined = false;
  view;

  constructor(scene, { token, join = {}, seed } = {}) {
    const key = seed === undefined ? undefined : hexadecimal(seed);
    give({ scene, token, key, join });
    this.#number = module().member_new();
    if (this.#number === 0) throw new RhumbError(output());
    this.view = new View(() => this.#handle);
    members.register(this, this.#number, this);
  }

  get #handle() {
    if (this.#number === 0) throw new RhumbError({ code: "notNow", message: "the member was freed" });
    return this.#number;
  }

  handleOpened(now) {
    module().handle_opened(this.#handle, moment(now));
  }

  handleControl(now, bytes) {
    giveBytes(bytes);
    module().handle_control(this.#handle, moment(now));
  }

  handleDatagram(now, bytes) {
    giveBytes(bytes);
    module().handle_datagram(this.#handle, moment(now));
  }

  handleTimeout(now) {
    module().handle_timeout(this.#handle, moment(now));
  }

  handleEnded(now, closeCode) {
    module().handle_ended(this.#handle, moment(now), closeCode ?? -1);
  }

  pollTransmit() {
    switch (module().poll_transmit(this.#handle)) {
      case 1:
        return { kind: "control", bytes: outputBytes() };
      case 2:
        return { kind: "state", bytes: outputBytes() };
      case 3:
        return { kind: "close", code: output() };
      default:
        return undefined;
    }
  }

  pollTimeout() {
    const at = module().poll_timeout(this.#handle);
    return at < 0 ? undefined : at;
  }

  pollEvent() {
    if (this.#events.length === 0) this.#events = found(module().poll_events(this.#handle)) ?? [];
    const event = this.#events.shift();
    if (event?.kind === "joined") this.#joined = true;
    return event;
  }

  get joined() {
    return this.#joined;
  }

  poll(now) {
    const ticks = module().poll_view(this.#handle, moment(now));
    if (ticks >= 0) this.view.time = ticks;
    return this.view.time;
  }

  show(ticks, now = 0) {
    if (!Number.isFinite(ticks) || ticks < 0) throw wrong("ticks", ticks, "finite and not negative");
    module().show(this.#handle, moment(now), ticks);
    this.view.time = ticks;
  }

  body(id) {
    return found(module().body(this.#handle, bodyOf(id)));
  }

  shape(id) {
    return found(module().shape(this.#handle, bodyOf(id)));
  }

  track(id) {
    return found(module().track(this.#handle, bodyOf(id)));
  }

  errorBound(id) {
    const bound = module().error_bound(this.#handle, bodyOf(id));
    return bound >= 0 ? bound : undefined;
  }

  tickErrorBound(id, tick) {
    if (!Number.isSafeInteger(tick) || tick < 0) {
      throw wrong("tick", tick, "a whole number that is not negative");
    }
    const bound = module().tick_error_bound(this.#handle, bodyOf(id), tick);
    return bound >= 0 ? bound : undefined;
  }

  get completeTick() {
    return module().complete_tick(this.#handle);
  }

  joints() {
    return new Map(found(module().state(this.#handle, JOINTS)));
  }

  get config() {
    return found(module().state(this.#handle, CONFIG));
  }

  get stream() {
    return found(module().state(this.#handle, STREAM));
  }

  get gravity() {
    return found(module().state(this.#handle, GRAVITY));
  }

  /** The state of the copy in the words of spec/vectors: equal for all implementations that have read the same bytes. */
  get digest() {
    return found(module().state(this.#handle, DIGEST));
  }

  get authorityBodies() {
    return found(module().state(this.#handle, AUTHORITY));
  }

  statistics(now) {
    return found(module().statistics(this.#handle, moment(now)));
  }

  /** Milliseconds for which a client of this scene tries to resume by default. */
  get resumeWithin() {
    return module().resume_within(this.#handle);
  }

  reconnect() {
    answer(module().reconnect(this.#handle));
  }

  close() {
    module().close(this.#handle);
  }

  changeStream(choice) {
    give(choice);
    answer(module().change_stream(this.#handle));
  }

  get cellGrid() {
    return found(module().state(this.#handle, CELL_GRID));
  }

  get cells() {
    return found(module().state(this.#handle, CELLS));
  }

  takeCells(cells) {
    give({ cells });
    answer(module().take_cells(this.#handle));
  }

  takeCellsAround(point, bands) {
    give({ point, bands });
    answer(module().take_cells(this.#handle));
  }

  setTierPolicy(policy) {
    give(policy);
    answer(module().set_tier_policy(this.#handle));
  }

  setDelayTicks(ticks) {
    answer(module().set_option(this.#handle, DELAY, number("ticks", ticks)));
  }

  setLeadTicks(ticks) {
    answer(module().set_option(this.#handle, LEAD, number("ticks", ticks)));
  }

  setSmooth(smooth) {
    if (typeof smooth !== "boolean") throw wrong("smooth", smooth, "true or false");
    answer(module().set_option(this.#handle, SMOOTH, smooth ? 1 : 0));
  }

  addBodies(bodies) {
    give(bodies);
    return answer(module().add_bodies(this.#handle));
  }

  command(command) {
    give(command);
    return answer(module().command(this.#handle));
  }

  removeUnusedShapes() {
    return answer(module().remove_unused_shapes(this.#handle));
  }

  query(queries) {
    give(queries);
    return answer(module().query(this.#handle));
  }

  takeAuthority(bodies, tolerance) {
    give({ bodies, tolerance });
    answer(module().take_authority(this.#handle));
  }

  publish(now, states) {
    if (!Array.isArray(states)) throw wrong("states", states, "a list of pairs of a body and its state");
    give(states.map((pair) => ({ id: pair?.[0], state: pair?.[1] })));
    return answer(module().publish(this.#handle, moment(now))) ?? undefined;
  }

  advance(now) {
    return answer(module().advance(this.#handle, moment(now)));
  }

  get awaitsAnswers() {
    return module().awaits_answers(this.#handle) !== 0;
  }

  giveUpAdvance() {
    module().give_up_advance(this.#handle);
  }

  inspect() {
    answer(module().inspect(this.#handle));
  }

  delete() {
    answer(module().delete(this.#handle));
  }

  free() {
    members.unregister(this);
    module().member_free(this.#number);
    this.#number = 0;
  }
}
