/**
 * Client of a remote physics scene in a browser: the session, the subscriber and the view of the Rust client, compiled
 * to WebAssembly, over WebTransport.
 *
 * A {@link Client} is a member of one scene and follows one stream of it; connect again for another scene or stream.
 * Only connecting and joining wait, and return promises. All other calls return at once; an answer arrives as an event.
 *
 * Frames and units: world frame, right-handed, SI. A rotation is a unit quaternion x, y, z, w, body → world.
 * A position is that of the centre of mass, or of the origin of a hull or compound that this page added. Velocities are those
 * of the centre of mass. Ticks are numbers.
 *
 * Every error of this module is a {@link RhumbError} with a code and a sentence that says what to do.
 */

/** A body's id, opaque: its index plus 2³² times its generation. Usable as a key of a `Map`. */
export type BodyId = number;
/** A shape's number in its scene. */
export type ShapeId = number;
/** A joint's number in its scene. */
export type JointId = number;
/** x, y, z. */
export type Vec3 = readonly [number, number, number];
/** x, y, z, w. */
export type Quat = readonly [number, number, number, number];

/**
 * Greatest error of a copy. A number: metres, for every point of a body, from 0.001 to 10. An object: bounds of their own
 * on the centre of mass (metres) and on the rotation (radians).
 */
export type Tolerance = number | { readonly position: number; readonly turn: number };

/** The named tiers of the Rust crates, in metres: 5 mm, 2 cm, 5 cm, 20 cm. */
export const TOLERANCE: { readonly exact: 0.005; readonly fine: 0.02; readonly normal: 0.05; readonly coarse: 0.2 };

/**
 * The stream that a client follows.
 *
 * `"full"`: every state at every tick, exact; the truth for a comparison. `"changed"`: the same without bodies that rest.
 * `within`: predicted, within a tolerance.
 * With a `budget`, the stream takes no more bytes per second of the scene's time, and states an error scale instead.
 */
export type StreamChoice =
  | "full"
  | "changed"
  | { readonly within: Tolerance; readonly budget?: number | { readonly bytesPerSecond: number; readonly burst: number } };

/** Places of a cell along x, y and z: from place times edge to place + 1 times edge; 0 along an axis that is not divided. */
export type Cell = readonly [x: number, y: number, z: number];

/** All cells within a distance of a point, metres to the nearest point of a cell, and their streams. */
export interface CellBand {
  readonly radius: number;
  readonly stream: StreamChoice;
}

/** A cell to take, and its stream. */
export interface CellChoice {
  readonly cell: Cell;
  readonly stream: StreamChoice;
}

/**
 * A cell that is taken. It is awaited until its snapshot has come, once more after a resumed session, which shows it until then as
 * it was; it stays shown while another stream is on its way. The next call that takes cells asks again for one that was denied.
 */
export interface TakenCell {
  readonly cell: Cell;
  readonly state: "awaited" | "shown" | "denied";
  /**
   * Why it is denied: `noSuchScene` is a cell that the grid has not, `tooManyStreams` one cell of the scene or of this client too
   * many, or one stream of the cell.
   */
  readonly denial?: DenialCode;
}

/** The streams that the server may move this client to when its link is congested: none, or tolerances up to a length. */
export type TierPolicy = "never" | { readonly upTo: number };

// ---------------------------------------------------------------------------------------------------------------------
// Connecting and joining

/** Options of {@link connect}. */
export interface ConnectOptions {
  /**
   * SHA-256 hashes of certificates that are accepted beside those of the browser's authorities: 64 hexadecimal digits, or
   * 32 bytes. The server prints them when it starts. The certificate must be short-lived, as the server's own is.
   *
   * A function is called before each attempt, so that a client that reconnects gets the hashes of the present moment.
   */
  readonly certificateHashes?:
    | readonly (string | BufferSource)[]
    | (() => Promise<readonly (string | BufferSource)[]>);
  /** The token that `rhumb-server token` made. Only a server started with `--open` needs none. */
  readonly token?: string;
  /** Cancels the attempt to connect or to join; afterwards it has no effect. */
  readonly signal?: AbortSignal;
  /** Time limit of connecting, of joining, and of each later call that waits, milliseconds. Default: 5000. */
  readonly timeout?: number;
  /** Where `rhumb.wasm` is. Default: beside `rhumb.js`. */
  readonly wasm?: WasmSource;
  /** The constructor of the transport. Default: `globalThis.WebTransport`. */
  readonly transport?: typeof WebTransport;
}

export type WasmSource = string | URL | Response | BufferSource | WebAssembly.Module;

/**
 * Connects to a server.
 *
 * `url`: `https://host:port` or `https://host:port/path`. Use the address `127.0.0.1` and not the name `localhost` for a
 * server of this machine, which listens at one of the two addresses of that name only.
 *
 * Rejects with a {@link RhumbError}: `unsupported` (this browser has no WebTransport), `connect` (not reached, another
 * certificate, or a page whose origin the server does not allow: a browser does not tell which), `timeout`, `aborted`,
 * `argument`.
 */
export function connect(url: string | URL, options?: ConnectOptions): Promise<ServerConnection>;

/** Compiles the module before it is needed; {@link connect} does it otherwise. */
export function load(wasm?: WasmSource): Promise<void>;

/** True if this browser can connect. */
export const isSupported: boolean;

/** The condition under which a client joins. */
export type JoinMode =
  /** The scene must exist. */
  | "join"
  /** The scene must not exist yet, and is created. */
  | { readonly create: SceneConfigOptions }
  /** An existing scene keeps its config. */
  | { readonly createOrJoin: SceneConfigOptions };

export interface JoinOptions {
  /** Default: `"join"`. */
  readonly mode?: JoinMode;
  /** Default: within 5 cm. */
  readonly stream?: StreamChoice;
  /**
   * Take the scene by cells, if its server divides it: see {@link Client.takeCellsAround}. The stream above is then of the
   * bodies that are in no cell. Default: false.
   */
  readonly cells?: boolean;
  /** Free running only: ticks that the view stays behind the server's clock, 0 to 3,600. Default: 0, prediction covers the delay. */
  readonly delayTicks?: number;
  /** Free running only: ticks ahead of the server's clock at which bodies under authority are published, 0 to 3,600. Default: 0. */
  readonly leadTicks?: number;
  /** Free running only: show whole ticks only. Default: false. */
  readonly wholeTicks?: boolean;
  /** Free running only: show corrections as short glides. Default: true. Off for a view that is compared with a truth. */
  readonly smooth?: boolean;
  /**
   * `"throw"`: the next {@link Client.poll} throws, and the next {@link Client.advance} rejects, with the code `refused` for
   * what the server refused, after the view is computed. `"events"`: events alone tell. Default: `"throw"`.
   */
  readonly refusals?: "throw" | "events";
  /**
   * Seconds for which the client tries to continue over another connection when one ends without its doing; commands are
   * queued meanwhile. Default: 60 if the server keeps the scene over its own end, else 0.
   */
  readonly resumeWithin?: number;
  /** As {@link Client.record}, from the first byte on, so that the recording can be replayed. */
  readonly record?: (channel: TapChannel, bytes: Uint8Array) => void;
}

/** A connection that has joined no scene yet. */
export class ServerConnection {
  /**
   * Joins a scene, and resolves when the copy of the scene is complete. A connection joins one scene, once.
   *
   * Rejects with a {@link RhumbError}: `denied` (with `denial`), `closed` (with `closeCode`), `timeout`, `argument`.
   */
  join(scene: string, options?: JoinOptions): Promise<Client>;
  /** Closes a connection that has not joined. */
  close(): void;
}

/** The config of a scene as the server has it. */
export interface SceneConfig {
  readonly stepping: "lockstep" | "freeRunning";
  /** Ticks per `seconds` seconds. */
  readonly rate: { readonly ticks: number; readonly seconds: number };
  /** Seconds of one tick. */
  readonly step: number;
  readonly substeps: number;
  /** At the start, m/s². */
  readonly gravity: Vec3;
  readonly material: Material;
  readonly damping: Damping;
  /** Of bodies without conditions of their own. */
  readonly sleep: Sleep;
  /** Ticks between published ticks. */
  readonly publishInterval: number;
  /** Ticks by which every copy is later, for a publisher that looks ahead. */
  readonly lookahead: number;
}

/** The config of a scene to create; what is left out has the default of the Rust crates (60 Hz, lockstep). */
export type SceneConfigOptions = Partial<Omit<SceneConfig, "step">>;

/**
 * Conditions under which a body falls asleep: `"settled"`, when it is slow and neither gravity nor a motor still moves it;
 * `"never"`; or when for some seconds no point of it was faster than a speed, m/s, nor it turned faster than rad/s.
 */
export type Sleep =
  | "settled"
  | "never"
  | { readonly speed: number; readonly angularSpeed: number; readonly seconds: number };

export interface Material {
  readonly friction: number;
  readonly restitution: number;
  /** kg/m³. */
  readonly density: number;
}

/** 1/s. */
export interface Damping {
  readonly linear: number;
  readonly angular: number;
}

// ---------------------------------------------------------------------------------------------------------------------
// A member of a scene

/** A member of one scene. */
export class Client {
  readonly scene: string;
  readonly config: SceneConfig;
  /** `"open"`; `"resuming"` while it tries to continue over another connection; `"ended"`. */
  readonly state: "open" | "resuming" | "ended";
  /** Why it ended; undefined before. */
  readonly ending?: RhumbError;

  /**
   * Handles what has arrived, and computes the view of the present moment. Call it once per frame.
   *
   * `now`: milliseconds of `performance.now()`, such as the argument of a `requestAnimationFrame` callback; at most ten seconds
   * from it, and a later moment counts as the present one. Default: the present moment. Returns the moment shown, in ticks; its fraction lies between two ticks.
   *
   * After the page stood still for seconds, what has arrived meanwhile is read only once its tasks run: the first view may be
   * old, and says so by infinite bounds. To show none of it, let a task pass before: `await new Promise((go) => setTimeout(go))`.
   *
   * A lockstep scene stands still until a member advances it. Throws `refused` for what the server refused, after the view is
   * computed; the next call continues.
   */
  poll(now?: number): number;

  /**
   * Computes the view of a moment of the caller's choice, in ticks, without smoothing. Two clients that show the same
   * moment can be compared.
   *
   * A copy keeps the tracks since the moment shown last, as many as {@link JoinOptions.delayTicks} or the last views needed, and
   * none before: a sudden step back is shown truly only for bodies without an update since. So compare at the newest tick that
   * both know:
   * `const tick = Math.min(copy.completeTick, truth.completeTick); copy.show(tick); truth.show(tick);` in each frame, and
   * skip a full stream's tick if its `completeTick` is already later. {@link View.errorBounds} is infinite where the copy
   * cannot tell.
   */
  show(ticks: number): void;

  /**
   * Steps a lockstep scene once; resolves with the tick of the view, as `Client::advance` of the Rust crate does.
   *
   * Rejects with `refused` for what the server refused, after the tick is done and its view computed: the next call continues.
   * Rejects with `timeout` if the tick does not come within the limit of `connect`: it stays requested, and the next call steps
   * once more. Also rejects with `denied`, with `sceneFaulted` once the scene's engine has failed, and with the reason why the client
   * ends, such as `sceneDeleted`.
   */
  advance(): Promise<number>;

  /** The view as of the last call that computed it. The same object at all times. */
  readonly view: View;

  /** The newest tick at which every body is within its tolerance; of a full stream, the tick of its states. */
  readonly completeTick: number;

  /** The stream that the copy follows now. */
  readonly stream: StreamChoice;
  /** Tolerance of that stream; undefined for a full stream, whose states are exact. */
  readonly tolerance: Tolerance | undefined;
  /**
   * Requests another stream. The event `subscriptionChanged` reports when the copy follows it; until then it follows the
   * present one, and no tick is missed.
   */
  changeStream(choice: StreamChoice): void;
  /**
   * Edges of the scene's cells along x, y and z, metres; 0 along an axis that is not divided. Undefined for a scene that is not
   * divided, and for one that was joined without {@link JoinOptions.cells}.
   */
  readonly cellGrid: Vec3 | undefined;
  /** The cells that are taken, and the state of each. */
  readonly cells: readonly TakenCell[];
  /**
   * Takes the cells around a point and no others: each by the stream of the nearest band that reaches it. Call it as the point
   * moves: what is taken already costs nothing. It does not wait. A radius of 0 takes the cell that has the point.
   *
   * The view has the bodies of these cells, each once, and those that are in no cell: bodies whose bounding radius is more than
   * half of the shortest edge, such as floors. A body that leaves the cells is among {@link View.removed}, and no event tells of
   * it: it was not removed from the scene. Throws for a scene that is not divided, for more than 256 cells, and for a point that
   * is in no world; then all stays as it was.
   */
  takeCellsAround(point: Vec3, bands: readonly CellBand[]): void;
  /** Takes these cells and no others. */
  takeCells(cells: readonly CellChoice[]): void;
  /** Sets the tiers that the server may choose for this client. Default of a server: up to 0.2 m. */
  setTierPolicy(policy: TierPolicy): void;
  /** Changes {@link JoinOptions.delayTicks}. */
  setDelayTicks(ticks: number): void;
  /** Changes {@link JoinOptions.leadTicks}. */
  setLeadTicks(ticks: number): void;
  /** Changes {@link JoinOptions.smooth}. */
  setSmooth(smooth: boolean): void;

  /**
   * The oldest unread event; undefined when there is none. At most 65,536 are kept: `eventsLeftOut` of the statistics counts
   * those that were dropped, the oldest first.
   */
  pollEvent(): Event | undefined;

  /** Present gravity, m/s². */
  readonly gravity: Vec3;
  /** A body's description; undefined for a body that the copy does not have. */
  body(id: BodyId): BodyDesc | undefined;
  /** A shape of the scene; undefined for an unknown number. */
  shape(id: ShapeId): Shape | undefined;
  /** The joints of the scene. */
  joints(): ReadonlyMap<JointId, Joint>;
  /** The track that the copy predicts a body from; undefined for a body that the copy does not have. */
  track(id: BodyId): Track | undefined;
  /** Bound on the error of the shown pose, metres: see {@link View.errorBounds}; `undefined` for a body that is not in the view. */
  errorBound(id: BodyId): number | undefined;
  /**
   * How far any point of a body may be off at a tick by what is known of it, whatever the view shows, metres: the bound of its
   * track. Infinite where nothing finite is known; `undefined` for a body that the copy does not have. Throws `argument` for a tick
   * that is no whole number.
   */
  tickErrorBound(id: BodyId, tick: number): number | undefined;

  /**
   * Queues the addition of a body, and of its shape unless the scene has an equal one; returns the body's id. The event
   * `bodyPlaced` or `refused` reports the result; a refusal is an error of the next {@link poll} or {@link advance}, too. Throws
   * `noIds` if the server must grant more ids first, which this call requests: repeat it after the event `reserved`.
   */
  addBody(body: BodyOptions): BodyId;
  /** As {@link addBody}, for many bodies. If one of them is invalid, none is queued. */
  addBodies(bodies: readonly BodyOptions[]): BodyId[];
  /** Queues a command, which is applied before the next tick; returns the number that its answer names. */
  command(command: Command): number;
  /**
   * Queues the removal of the shapes that came with bodies of this client and that no body has any more; returns their
   * number. A scene holds a limited number of bytes of shapes, and keeps them until they are removed.
   */
  removeUnusedShapes(): number;
  /**
   * Queues queries in one message; returns the number that the event `queryResult` names. Those that are not answered at
   * the event `interrupted` get no answer, and until `resumed` it throws.
   */
  query(queries: readonly Query[]): number;
  /** Sends what is queued. Otherwise it is sent before the next task of the event loop. */
  flush(): void;

  /**
   * Requests authority over these kinematic bodies, in place of those that this client has authority over now. The event
   * `authorityGrant` or `authorityDenied` reports the result. An empty list ends the authority. While the session is
   * interrupted it waits; a session that continues requests its authority again by itself.
   *
   * One member has authority over 256 bodies at most. The server's bodies are within `tolerance` of what {@link publish}
   * sends, and the tolerance of a stream adds to it: a member that follows these bodies within 0.05 m sees them within
   * 0.07 m of the publisher's if that one's is 0.02 m. Throws `argument` for more bodies, and `notNow` while the event that
   * answers an earlier request is still to come. For a member by cells, the grant of a body waits until a cell that it takes has had
   * the body.
   */
  takeAuthority(bodies: readonly BodyId[], tolerance: Tolerance): void;
  /** The bodies under this client's authority. */
  readonly authorityBodies: readonly BodyId[];
  /**
   * Publishes the present states of bodies under this client's authority; call it once per frame. Returns the tick of the
   * states, or undefined if nothing was published: before the grant, while the session is interrupted, before the clock is
   * known, twice in one tick.
   */
  publish(states: readonly (readonly [BodyId, BodyState])[]): number | undefined;

  /** Requests an inspection; resolves with the server's answer. Rejects as {@link advance}, but not after a fault. */
  inspect(): Promise<Inspection>;
  /** Deletes the scene for all members; resolves when it is done. Then each of them ends with `sceneDeleted`. */
  delete(): Promise<void>;

  readonly statistics: Statistics;

  /** The state of the copy in the words of spec/vectors, for comparison with another client. */
  readonly digest: Digest | undefined;

  /** Calls `tap` with all bytes in both directions, for recording; undefined ends it. The bytes are the callee's. */
  record(tap: ((channel: TapChannel, bytes: Uint8Array) => void) | undefined): void;

  /** Leaves the scene and closes the connection; commands sent before are delivered first. */
  close(): void;
  /** Settles when the client has ended, with the reason. */
  readonly closed: Promise<RhumbError>;
}

/** spec/vectors/README.md has the words. */
export interface Digest {
  readonly watermark: number;
  readonly complete: number;
  readonly converged: boolean;
  readonly next: number;
  readonly missing: number;
  /** Over all tracks. */
  readonly checksum: string;
  /** Over all predicted motions at the watermark, while nothing is missing. */
  readonly poses?: string;
}

export type TapChannel = "controlDown" | "controlUp" | "stateDown" | "stateUp";

/**
 * The poses of all bodies at one moment, in parallel arrays.
 *
 * The arrays are views of the module's memory: nothing is copied. They are valid until the next call of any method of the
 * client, so read the property in each frame and do not keep it. The place of a body changes only when bodies are added
 * or removed; `generation` tells.
 */
export interface View {
  /** Number of bodies. */
  readonly count: number;
  /** The moment shown, ticks. */
  readonly time: number;
  /** Grows whenever a body is added, removed or described anew, that is whenever `ids`, `shapes` or `kinds` change. */
  readonly generation: number;
  /** Body ids, one per place. */
  readonly ids: Float64Array;
  /** Shape of each body. */
  readonly shapes: Uint32Array;
  /** Kind of each body: 0 fixed, 1 dynamic, 2 kinematic. */
  readonly kinds: Uint8Array;
  /** x, y, z of each body's centre of mass, or of the origin of a hull or compound that this page added, metres. */
  readonly positions: Float32Array;
  /** x, y, z, w of each body's rotation. */
  readonly rotations: Float32Array;
  /** As shown, m/s; zero at rest. */
  readonly linearVelocities: Float32Array;
  /** As shown, rad/s; zero at rest. */
  readonly angularVelocities: Float32Array;
  /** 1 for each body at rest: its pose does not change until its next update or event. */
  readonly resting: Uint8Array;
  /** Places whose pose differs from that of the view before, each once. */
  readonly changed: Uint32Array;
  /** Bodies of the view before that are not in this one: removed, or in no cell that is taken. */
  readonly removed: Float64Array;
  /** Tick of each body's last update; zero while the client resumes. Computed when read. */
  readonly updateTicks: Float64Array;
  /**
   * How far each shown pose may be from the body's true pose at the moment of the view, metres. Infinite while nothing finite is
   * known: a packet is missing, the view shows a moment of which the news has not arrived, or the client resumes. Computed when
   * read.
   */
  readonly errorBounds: Float32Array;
  /** Tolerance of each body in this stream, metres; zero for a full stream, and while the client resumes. Computed when read. */
  readonly tolerances: Float32Array;
  /** Place of a body; undefined if it is not in this view: a typed array has `undefined` there. */
  place(id: BodyId): number | undefined;
}

/** The track that a copy predicts a body from: its last published state and the predictor that continues it. */
export interface Track {
  /** Tick of the state. */
  readonly origin: number;
  readonly predictor: "rest" | "uniform" | "ballistic" | "torqueFree" | "ballisticTorqueFree" | "accelerated";
  /** Of the predictor `accelerated`, m/s². */
  readonly acceleration?: Vec3;
  /** True if the state has the engine's exact bits; false if it is quantised. */
  readonly exact: boolean;
  /** The state, in the frame of the parent if there is one. */
  readonly state: BodyState;
  /** The body that moves this one. */
  readonly parent?: BodyId;
}

export interface BodyState {
  readonly position: Vec3;
  readonly rotation?: Quat;
  readonly linearVelocity?: Vec3;
  readonly angularVelocity?: Vec3;
}

// ---------------------------------------------------------------------------------------------------------------------
// Parts of a scene

/** Lengths in metres, from the body's centre of mass, but for hulls and compounds; long axes along the body's y. */
export type Shape =
  | { readonly kind: "ball"; readonly radius: number }
  | { readonly kind: "cuboid"; readonly halfExtents: Vec3 }
  | { readonly kind: "roundedCuboid"; readonly halfExtents: Vec3; readonly radius: number }
  | { readonly kind: "capsule"; readonly halfHeight: number; readonly radius: number }
  | { readonly kind: "cylinder"; readonly halfHeight: number; readonly radius: number }
  /** Its tip points along y; its base is half of `halfHeight` below the centre of mass. */
  | { readonly kind: "cone"; readonly halfHeight: number; readonly radius: number }
  /** Everything behind a plane through the body's origin. */
  | { readonly kind: "halfSpace"; readonly normal: Vec3 }
  /**
   * x, y, z of each point, from any origin: the centre of mass is found, and poses that this page gives and gets are those of
   * the origin. 255 corners at most; other points are left out.
   */
  | { readonly kind: "hull"; readonly points: readonly number[] }
  /**
   * A height for each post, row by row: post (r, c) stands at x = r · rowSpacing, y = heights[r · columns + c],
   * z = c · columnSpacing from the body's origin.
   */
  | {
      readonly kind: "heights";
      readonly rows: number;
      readonly columns: number;
      readonly rowSpacing: number;
      readonly columnSpacing: number;
      readonly edges?: Edges;
      readonly heights: readonly number[];
    }
  /** x, y, z of each point; three point numbers of each triangle. */
  | {
      readonly kind: "mesh";
      readonly edges?: Edges;
      readonly points: readonly number[];
      readonly triangles: readonly number[];
    }
  | { readonly kind: "compound"; readonly parts: readonly Part[] };

/**
 * How bodies touch the edges that two triangles share: `"plain"` as if each triangle were alone, so that a body that slides
 * over flat ground may catch on one; `"smooth"` as one face. Heights with smooth edges are touched from above only.
 */
export type Edges = "plain" | "smooth";

export interface Part {
  readonly position: Vec3;
  readonly rotation: Quat;
  readonly shape: Exclude<Shape, { kind: "compound" }>;
}

export type BodyKind = "fixed" | "dynamic" | "kinematic";

/** Everything constant of a body but its id and shape. What is left out has the scene's or the protocol's default. */
export interface BodyProperties {
  readonly kind: BodyKind;
  readonly material?: Material;
  readonly damping?: Damping;
  /** Factor on the scene's gravity. Default: 1. */
  readonly gravityScale?: number;
  /** False: its axis of spin stays, though its moments of inertia differ. Default: true. */
  readonly gyroscopic?: boolean;
  /** Power of two by which its tolerance differs from the stream's. Default: 0. */
  readonly toleranceScale?: number;
  /** Bits of the locked axes: translations along x, y, z (1, 2, 4), rotations about x, y, z (8, 16, 32). Default: 0. */
  readonly lockedAxes?: number;
  /** kg, and moments of inertia, kg·m². Default: from the shape and the density. */
  readonly mass?: { readonly mass: number; readonly moments?: Vec3 };
  readonly groups?: { readonly members: number; readonly touches: number };
  readonly dominance?: number;
  readonly sensor?: boolean;
  readonly swept?: boolean;
  /** Default: the scene's. */
  readonly sleep?: Sleep;
  /** Default: true. */
  readonly enabled?: boolean;
}

/** A body as the copy has it. */
export interface BodyDesc extends BodyProperties {
  readonly id: BodyId;
  readonly shape: ShapeId;
}

/** A body to add. */
export interface BodyOptions extends BodyProperties, Partial<BodyState> {
  readonly shape: Shape;
}

export interface JointFrame {
  /** From the origin of the body's shape, along its axes, metres. */
  readonly anchor: Vec3;
  /** Frame → body. Default: the axes of the body. */
  readonly rotation?: Quat;
}

/** Radians or metres, inclusive. */
export interface JointLimits {
  readonly least: number;
  readonly most: number;
}

export interface Motor {
  readonly position: number;
  readonly velocity: number;
  readonly stiffness: number;
  readonly damping: number;
  readonly force: number;
}

export type JointKind =
  | { readonly kind: "fixed" }
  | { readonly kind: "spherical"; readonly limits?: readonly [JointLimits, JointLimits, JointLimits] }
  | { readonly kind: "revolute"; readonly limits?: JointLimits }
  | { readonly kind: "prismatic"; readonly limits?: JointLimits }
  | { readonly kind: "rope"; readonly length: number }
  | { readonly kind: "spring"; readonly length: number; readonly stiffness: number; readonly damping: number }
  /** `limits`: six, null for an axis without. */
  | { readonly kind: "generic"; readonly lockedAxes: number; readonly limits: readonly (JointLimits | null)[] };

export type Joint = JointKind & {
  readonly bodies: readonly [BodyId, BodyId];
  readonly frames: readonly [JointFrame, JointFrame];
  /** Default: false. */
  readonly collide?: boolean;
  /** Six, null for an axis without: translations along x, y, z, rotations about x, y, z. Default: none. */
  readonly motors?: readonly (Motor | null)[];
  /** N and N·m. Default: it never breaks. */
  readonly strength?: { readonly force: number; readonly torque: number };
};

// >>> records, made by bindings/table
/** A character: a kinematic body that walks by its velocity, as far as the world lets it, and falls. */
export interface Character {
  /** Gap that it keeps to its surroundings: 0.001 to 10,000 m. Default: 0.02. */
  readonly offset?: number;
  /** Steepest slope that it climbs, from level ground: 0 to π/2 rad. Default: π/4. */
  readonly climbAngle?: number;
  /** Slope from which on it slides down, from level ground: 0 to π/2 rad. Default: π/4. */
  readonly slideAngle?: number;
  /** Mass with which it pushes dynamic bodies, none at zero: 0 to 1,000,000 kg. Default: 80. */
  readonly mass?: number;
  /** Direction away from the ground, of unit length, instead of the one against gravity. */
  readonly up?: Vec3;
  /**
   * `height`: greatest height of a step that it climbs: 0.001 to 10,000 m; `width`: free width that it needs on a step:
   * 0.001 to 10,000 m; `ontoDynamic`: it also climbs onto dynamic bodies; otherwise it pushes them. Default: none.
   */
  readonly step?: { readonly height: number; readonly width: number; readonly ontoDynamic?: boolean };
  /** Greatest drop of the ground that it follows without a fall: 0.001 to 10,000 m. Default: 0.2. Zero: none. */
  readonly snap?: number;
}

/** A wheel of a vehicle, in the axes of its chassis and from the origin of its shape: a ray with a spring. */
export interface Wheel {
  /** Upper end of the suspension: at most 10,000 m along each axis. */
  readonly position: Vec3;
  /** Direction of the suspension, of unit length, towards the ground. Default: 0, -1, 0. */
  readonly direction?: Vec3;
  /** Axis about which the wheel turns, of unit length, to the right of the way forward. Default: 1, 0, 0. */
  readonly axle?: Vec3;
  /** Radius of the wheel: 0.001 to 10,000 m. */
  readonly radius: number;
  /** Length of the suspension without load, from the position to the wheel's centre: 0 to 10,000 m. Default: 0.3. */
  readonly restLength?: number;
  /** Greatest change of that length: 0 to 10,000 m. Default: 0.25. */
  readonly travel?: number;
  /** Acceleration of the chassis for a change of that length: 0 to 1,000,000 1/s². Default: 50. */
  readonly stiffness?: number;
  /** Damping while the spring is compressed: 0 to 1,000,000 1/s. Default: 4. */
  readonly compression?: number;
  /** Damping while the spring relaxes: 0 to 1,000,000 1/s. Default: 6. */
  readonly relaxation?: number;
  /** Greatest force of the suspension: 0 to 1,000,000,000 N. Default: any. */
  readonly forceMax?: number;
  /**
   * Greatest force along the ground, as a share of the suspension's force, of which the part along the way forward
   * counts half: 0 to 100. Default: 2.
   */
  readonly frictionSlip?: number;
  /** Factor of the force along the axle that keeps the wheel from sliding sideways: 0 to 100. Default: 1. */
  readonly sideFriction?: number;
}

/** Steering, force and brake of a wheel. Without any, it rolls freely. */
export interface WheelInput {
  /** Turn about the axis that points up, to the left if positive: -π to π rad. Default: 0. */
  readonly steering?: number;
  /** Force along the way forward, backward if negative: -1,000,000,000 to 1,000,000,000 N. Default: 0. */
  readonly force?: number;
  /** Greatest force that stops it, while it has no force: 0 to 1,000,000,000 N. Default: 0. */
  readonly brake?: number;
}

/** Events that a body reports. */
export interface ActiveEvents {
  /** Its contacts begin and end. */
  readonly contacts?: boolean;
  /** Bodies enter and leave the sensor, or the body enters and leaves sensors. */
  readonly sensors?: boolean;
  /** It falls asleep and wakes. */
  readonly sleep?: boolean;
  /** Least force of a contact that is reported, in each tick, zero for all: 0 to 1,000,000,000 N. */
  readonly force?: number;
}

// <<< records

/** One command. Forces act during the next tick, impulses at once. N, N·m, N·s, N·m·s; points in metres, world frame. */
export type Command =
  // >>> commands, made by bindings/table
  /** Removes a body, and its joints. */
  | { readonly kind: "removeBody"; readonly id: BodyId }
  /**
   * Puts a fixed or dynamic body elsewhere at once, and moves a kinematic one there during the next tick. If poses of a
   * kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to the next, carries what
   * lies on it, and stops at the last one. A pose that is farther than 100 m/s or a quarter of a turn in a tick from
   * where its motion leads is a jump that shoves nothing. If a velocity is set after the pose, the body is there after
   * one tick and continues at that velocity. `position`: place of its centre of mass, or of the origin of a hull or
   * compound added here: at most 100,000 m along each axis. `rotation`: unit quaternion x, y, z, w, body to world.
   * Default: 0, 0, 0, 1.
   */
  | { readonly kind: "setPose"; readonly id: BodyId; readonly position: Vec3; readonly rotation?: Quat }
  /**
   * Sets both velocities. A kinematic body keeps them, and a character walks by them. `linear`: velocity of the centre
   * of mass: at most 1,000 m/s along each axis. `angular`: angular velocity about world axes: at most 100 rad/s along
   * each axis. Default: 0, 0, 0.
   */
  | { readonly kind: "setVelocity"; readonly id: BodyId; readonly linear: Vec3; readonly angular?: Vec3 }
  /**
   * Applies a force at the centre of mass during the next tick; one that makes the body too fast is refused. `force`:
   * in world axes: at most 1,000,000,000 N along each axis. `point`: point of the world where it acts: at most 100,000
   * m along each axis.
   */
  | { readonly kind: "force"; readonly id: BodyId; readonly force: Vec3; readonly point?: Vec3 }
  /**
   * Applies a torque during the next tick; one that makes the body spin too fast is refused. `torque`: about world
   * axes: at most 1,000,000,000 N·m along each axis.
   */
  | { readonly kind: "torque"; readonly id: BodyId; readonly torque: Vec3 }
  /**
   * Applies an impulse at the centre of mass: the velocity changes at once; one that makes the body too fast is
   * refused. `impulse`: in world axes: at most 1,000,000,000 N·s along each axis. `point`: point of the world where it
   * acts: at most 100,000 m along each axis.
   */
  | { readonly kind: "impulse"; readonly id: BodyId; readonly impulse: Vec3; readonly point?: Vec3 }
  /**
   * Applies an angular impulse: the spin changes at once; one that makes the body spin too fast is refused. `impulse`:
   * about world axes: at most 1,000,000,000 N·m·s along each axis.
   */
  | { readonly kind: "torqueImpulse"; readonly id: BodyId; readonly impulse: Vec3 }
  /** Puts a dynamic body to sleep, until something that moves touches it. */
  | { readonly kind: "sleep"; readonly id: BodyId }
  /** Wakes a dynamic body. */
  | { readonly kind: "wake"; readonly id: BodyId }
  /** Turns the events of a body on; what is left out, off. A new body reports none. */
  | { readonly kind: "setEvents"; readonly id: BodyId; readonly events: ActiveEvents }
  /** Makes a character or a vehicle an ordinary body again. */
  | { readonly kind: "clearLocomotion"; readonly id: BodyId }
  /**
   * Makes a kinematic body a character, which walks by the velocity that is set, or gives a character other settings.
   * Events report when it reaches the ground and when it leaves it.
   */
  | { readonly kind: "setCharacter"; readonly id: BodyId; readonly character: Character }
  /** Makes a dynamic body a vehicle, whose wheels begin without inputs. */
  | { readonly kind: "setVehicle"; readonly id: BodyId; readonly wheels: readonly Wheel[] }
  /**
   * Lets a character rise along its direction up. In the air nothing happens, unless it may jump from anywhere.
   * `speed`: speed with which it rises: -1,000 to 1,000 m/s. `from`: ground that the jump needs. Default: `"ground"`.
   */
  | { readonly kind: "jump"; readonly id: BodyId; readonly speed: number; readonly from?: "ground" | "anywhere" }
  /**
   * Sets steering, force and brake of all wheels of a vehicle. It keeps them until the next ones. `inputs`: in the
   * order of the wheels.
   */
  | { readonly kind: "setWheels"; readonly id: BodyId; readonly inputs: readonly WheelInput[] }
  /** Changes the gravity of the scene. `gravity`: in world axes: at most 1,000 m/s² along each axis. */
  | { readonly kind: "setGravity"; readonly gravity: Vec3 }
  // <<< commands
  /** Replaces the description of a body; pose and velocities stay. */
  | { readonly kind: "changeBody"; readonly desc: BodyDesc }
  | { readonly kind: "addShape"; readonly id: ShapeId; readonly shape: Shape }
  | { readonly kind: "removeShape"; readonly id: ShapeId }
  | { readonly kind: "addJoint" | "changeJoint"; readonly id: JointId; readonly joint: Joint }
  | { readonly kind: "removeJoint"; readonly id: JointId };

/** Which bodies a query considers. Default: all but sensors. */
export interface QueryFilter {
  readonly withFixed?: boolean;
  readonly withDynamic?: boolean;
  readonly withKinematic?: boolean;
  readonly withSensors?: boolean;
  readonly except?: BodyId;
  readonly groups?: number;
}

/** A question about the scene after the newest tick that the server has. Vectors are in metres and in the world's frame. */
export type Query = (
  /**
   * The nearest bodies on a line from `origin` to `origin + translation`: `translation` is the whole way, not a direction, and
   * not zero. A body whose surface the line only reaches with its end is not hit.
   */
  | { readonly kind: "ray"; readonly origin: Vec3; readonly translation: Vec3 }
  /**
   * The nearest bodies that a shape touches on its way, unturned. A shape of a query is a ball, cuboid, rounded cuboid, capsule,
   * cylinder or cone.
   */
  | { readonly kind: "shapeCast"; readonly shape: Shape; readonly position: Vec3; readonly rotation?: Quat; readonly translation: Vec3 }
  /** The bodies whose surfaces are nearest to a point, up to `distance`. Bodies that contain the point come first. */
  | { readonly kind: "projection"; readonly point: Vec3; readonly distance: number }
  /** The bodies that a shape overlaps. */
  | { readonly kind: "overlap"; readonly shape: Shape; readonly position: Vec3; readonly rotation?: Quat }
  /** The bodies that touch this one, the deepest contact first; none of a body that is not there. */
  | { readonly kind: "contacts"; readonly body: BodyId }
) & {
  readonly filter?: QueryFilter;
  /** Most bodies in its answer, 1 to 64. Default: 1; of contacts 64. */
  readonly hits?: number;
};

// ---------------------------------------------------------------------------------------------------------------------
// Events

/**
 * An answer of the server, or a change of the scene.
 *
 * `complete`: the newest complete tick when the data with which the event arrived was read. `number`: what the call returned
 * that sent the command or the query. `message`: a sentence for people.
 */
export type Event = { readonly complete: number } & (
  /** A body was placed in the scene, or its description was replaced. */
  | { readonly kind: "bodyPlaced"; readonly id: BodyId }
  /** A body was removed: by a command, because it left the world, or because its state was not finite. */
  | { readonly kind: "bodyRemoved"; readonly id: BodyId; readonly cause: "command" | "leftWorld" | "notFinite" }
  /** All commands up to `through` were applied or refused; they act in the step after `tick`. */
  | { readonly kind: "applied"; readonly through: number; readonly tick: number }
  /** A command was refused and changed nothing; `body` is one that the reason names. */
  | { readonly kind: "refused"; readonly number: number; readonly body?: BodyId; readonly reason: string; readonly message: string }
  /** The scene up to `tick`, and this many commands of the session, survive a crash of the server. */
  | { readonly kind: "durable"; readonly commands: number; readonly tick: number }
  /** The server granted further body ids: what threw `noIds` can be repeated. */
  | { readonly kind: "reserved" }
  /** The server denied a request about the scene. */
  | { readonly kind: "denied"; readonly denial: DenialCode; readonly message: string }
  /** The copy follows this stream from now on. */
  | { readonly kind: "subscriptionChanged"; readonly stream: StreamChoice }
  /** The server moves this client to another stream because of its link; `subscriptionChanged` follows. */
  | { readonly kind: "tierChanged"; readonly to: StreamChoice; readonly cause: "linkCongested" | "linkRecovered" }
  /** This client has authority over these bodies and no others. */
  | { readonly kind: "authorityGrant"; readonly bodies: readonly BodyId[] }
  /** The server denied authority; what was granted before stays. `body` is one that the reason names. */
  | { readonly kind: "authorityDenied"; readonly body?: BodyId; readonly reason?: string; readonly message: string }
  /** The answers to the queries of one call, in their order, evaluated after `tick`. */
  | { readonly kind: "queryResult"; readonly number: number; readonly tick: number; readonly answers: readonly QueryHit[][] }
  /** None of the queries of that call is answered. */
  | { readonly kind: "queryFailed"; readonly number: number; readonly tick: number; readonly message: string }
  /** Two bodies began to touch; or the force between them reached the threshold of `body`. */
  | { readonly kind: "contactBegan" | "contactForce"; readonly tick: number; readonly body: BodyId; readonly contact: Contact }
  /** They ceased to touch, or one of them was removed. */
  | { readonly kind: "contactEnded"; readonly tick: number; readonly body: BodyId; readonly with: BodyId }
  /** `body` entered or left a sensor. */
  | { readonly kind: "sensorEntered" | "sensorLeft"; readonly tick: number; readonly sensor: BodyId; readonly body: BodyId }
  /**
   * A body fell asleep or woke; its state was not finite, and it was removed (`bodyFault`); a character reached ground that
   * carries it, or has none any more.
   */
  | { readonly kind: "fellAsleep" | "woke" | "bodyFault" | "reachedGround" | "leftGround"; readonly tick: number; readonly body: BodyId }
  /**
   * `count` events of bodies were not sent or not kept, in this tick or before it. The events that follow tell anew which pairs
   * touch and which bodies are in sensors, but for `untold` of them.
   */
  | { readonly kind: "eventsMissed"; readonly tick: number; readonly count: number; readonly untold: number }
  /** The copy differed from the server's scene, by a fault of either; it is requested anew. */
  | { readonly kind: "checksumMismatch" }
  /** The server receives nothing from the member with authority over the body: from `since` on its error bound is infinite. */
  | { readonly kind: "publisherSilent"; readonly body: BodyId; readonly since: number }
  /** It receives from that member again, or its authority has ended: from `tick` on the body has an error bound. */
  | { readonly kind: "publisherActive"; readonly body: BodyId; readonly tick: number }
  /**
   * The engine failed, and the scene stands still after `tick`: the server keeps no earlier state (`noWayBack`), the engine
   * failed again from each (`failedAgain`), or the scene was restored as often as the server allows (`tooOften`).
   */
  | { readonly kind: "sceneFaulted"; readonly tick: number; readonly cause: "noWayBack" | "failedAgain" | "tooOften" }
  /** The engine failed, and the scene continues from `tick` without the commands that it failed on. */
  | { readonly kind: "sceneRestored"; readonly tick: number }
  /** The connection ended, and the client tries to resume. */
  | { readonly kind: "interrupted"; readonly message: string }
  /** The client continues with its session over another connection. */
  | { readonly kind: "resumed" }
  /** The server does not know the session any more: which of its last commands were done is unknown. */
  | { readonly kind: "sessionLost" }
  /** The membership ended; or the scene was deleted. */
  | { readonly kind: "left" | "deleted" }
  /** The connection ended. No event follows. */
  | { readonly kind: "ended"; readonly error: RhumbError }
);

/** Where two bodies touch deepest: `body` of the event, which has the lesser id, and `with`. Metres and newtons, world frame. */
export interface Contact {
  readonly with: BodyId;
  /** On the surface of `body`. */
  readonly point: Vec3;
  /** Of length 1, towards `body`. */
  readonly normal: Vec3;
  /** Between the surfaces; negative if they overlap. */
  readonly separation: number;
  /** The sum of the sizes of all forces between the two in that step. */
  readonly force: number;
}

export interface QueryHit {
  readonly body: BodyId;
  /** Metres: along the way, from the point to the surface, or of contacts between the surfaces. Undefined for an overlap. */
  readonly distance?: number;
  /** On the body's surface, of a contact on that of the body that is asked about. */
  readonly point?: Vec3;
  readonly normal?: Vec3;
}

export interface Inspection {
  readonly tick: number;
  readonly bodies: number;
  readonly awake: number;
  readonly updates: number;
  readonly packets: number;
  readonly packetBytes: number;
  readonly mismatches: number;
  readonly overBudget: number;
  /** Nanoseconds of the engine's steps: the median and the 99th percentile. */
  readonly stepMedian: number;
  readonly stepP99: number;
}

/** Counters since the client connected, over all its connections. Bytes are payloads of datagrams and of the stream. */
export interface Statistics {
  readonly receivedDatagrams: number;
  readonly receivedDatagramBytes: number;
  readonly receivedControlBytes: number;
  readonly sentDatagrams: number;
  readonly sentDatagramBytes: number;
  readonly sentControlBytes: number;
  /** Unread events that were dropped, the oldest first, beyond 65,536. */
  readonly eventsLeftOut: number;
  /** Milliseconds, as the session measures it. */
  readonly roundTrip: number;
  /** Of the present stream. */
  readonly packets: number;
  readonly updates: number;
  /** Packets found missing. */
  readonly missed: number;
  /** Packets recovered from repair symbols. */
  readonly rebuilt: number;
  readonly repairSymbols: number;
  /** Parts of refreshes applied. */
  readonly refreshes: number;
  readonly disordered: number;
  readonly duplicates: number;
  readonly malformed: number;
  readonly checksumsCompared: number;
  readonly checksumMismatches: number;
  /** Packets missing now. */
  readonly missing: number;
  /** The newest tick up to which everything published is known. */
  readonly watermarkTick: number;
  /** The newest tick at which every body is within its tolerance. */
  readonly completeTick: number;
  /** Present factor on the tolerances of a stream with a budget, null where it has not been stated; 1 otherwise. */
  readonly errorScale: number | null;
  /** Ticks by which the view lies behind the server's clock; null before the clock is known. */
  readonly behindTicks: number | null;
  /** Updates and bytes of the upstream since the last authority grant. */
  readonly upstream: { readonly updates: number; readonly packets: number; readonly bytes: number };
}

// ---------------------------------------------------------------------------------------------------------------------
// Errors

export type ErrorCode =
  /** This browser has no WebTransport. */
  | "unsupported"
  /** The server was not reached, has another certificate, or does not allow the page's origin. */
  | "connect"
  | "timeout"
  | "aborted"
  /** An argument is not what this call takes; the sentence names it. Nothing was sent. */
  | "argument"
  /** The call is not possible in the present state. */
  | "notNow"
  /** The server has granted no more body ids yet; see {@link Client.addBody}. */
  | "noIds"
  | "tooManyShapes"
  /** The server denied the request; `denial` has the reason. */
  | "denied"
  /** The connection was closed; `closeCode` has the reason. */
  | "closed"
  /** The connection broke or timed out. */
  | "broken"
  /** A member deleted the scene: the client has ended. */
  | "sceneDeleted"
  /** The scene's engine failed: the scene has stopped, but the client continues. */
  | "sceneFaulted";

export type DenialCode =
  | "noSuchScene"
  | "sceneExists"
  | "invalidConfig"
  | "tooManyScenes"
  | "tooManyMembers"
  | "tooManyStreams"
  | "noIndicesLeft"
  | "notLockstep"
  | "tooFarAhead"
  | "sceneFaulted"
  | "owned"
  | "notAllowed"
  | "advanceNotAllowed"
  | "overQuota"
  | "overloaded"
  | "other";

/** An error of this module. `message` is a sentence for people. */
export class RhumbError extends Error {
  readonly code: ErrorCode;
  readonly denial?: DenialCode;
  /** Code with which the server closed the connection (PROTOCOL 3.4). */
  readonly closeCode?: number;
  /** Of the code `refused`: what the server refused, the first 1,024, the oldest first. */
  readonly refusals?: readonly Refusal[];
  /** Of the code `refused`: the number of further refusals. They are events, too. */
  readonly refusalsLeftOut?: number;
}

/** A request that the server refused, and that changed nothing. */
export interface Refusal {
  /** The command's number; none for a request for authority. */
  readonly number?: number;
  /** The body that the request is about, if that is known. */
  readonly body?: BodyId;
  /** The reason in one or a few words, for programs, such as `"unknown body"`. */
  readonly reason: string;
  /** The reason, a sentence. */
  readonly message: string;
}

// ---------------------------------------------------------------------------------------------------------------------
// Without a network

/** Events of a {@link Member}: those of a client, and those that a client handles itself. */
export type MemberEvent =
  | Exclude<Event, { readonly kind: "ended" | "interrupted" }>
  | { readonly kind: "joined" }
  | { readonly kind: "joinFailed"; readonly error: { readonly code: ErrorCode; readonly message: string; readonly denial?: DenialCode } }
  | { readonly kind: "inspected"; readonly inspection: Inspection }
  /**
   * `mayResume`: another connection may continue the session. `elsewhere`: the address of the server that has the scene, as
   * `rhumb://host:port#fingerprint`.
   */
  | {
      readonly kind: "ended";
      readonly code: ErrorCode;
      readonly message: string;
      readonly closeCode?: number;
      readonly mayResume: boolean;
      readonly elsewhere?: string;
    };

/**
 * A member of a scene without socket or clock: bytes in, bytes out. {@link Client} drives one; a player of recorded bytes
 * drives another. `now`: milliseconds of a clock that does not go back.
 */
export class Member {
  /** `load` must have resolved before. `seed`: 16 random bytes, the key of a session that may resume; without it, none may. */
  constructor(scene: string, options?: { readonly token?: string; readonly join?: JoinOptions; readonly seed?: Uint8Array });
  handleOpened(now: number): void;
  handleControl(now: number, bytes: Uint8Array): void;
  handleDatagram(now: number, bytes: Uint8Array): void;
  handleTimeout(now: number): void;
  /** `closeCode`: that of a peer that closed; undefined for a connection that broke. */
  handleEnded(now: number, closeCode?: number): void;
  /** The next transmission; undefined when there is none. The bytes are the caller's. */
  pollTransmit(): { readonly kind: "control" | "state"; readonly bytes: Uint8Array } | { readonly kind: "close"; readonly code: number } | undefined;
  /** The moment of the next `handleTimeout`; undefined if none is needed. */
  pollTimeout(): number | undefined;
  pollEvent(): MemberEvent | undefined;
  /** True once the event `joined` was read: the copy of the scene is complete. */
  readonly joined: boolean;
  readonly config: SceneConfig | undefined;
  readonly completeTick: number;
  readonly view: View;
  poll(now: number): number;
  show(ticks: number): void;
  body(id: BodyId): BodyDesc | undefined;
  shape(id: ShapeId): Shape | undefined;
  track(id: BodyId): Track | undefined;
  errorBound(id: BodyId): number | undefined;
  tickErrorBound(id: BodyId, tick: number): number | undefined;
  /** The state of the copy in the words of spec/vectors: equal to that of every client that has read the same bytes. */
  readonly digest: Digest | undefined;
  /** Frees the module's memory of this member. Afterwards its calls, and those of its view, throw `notNow`. */
  free(): void;
}
