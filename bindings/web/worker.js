// A client in a worker: `new Worker(new URL("worker.js", ...), { type: "module" })`.
//
// Messages to it: { kind: "connect", url, options, scene, join }, once, and again after its client has ended; { kind: "frame" }, for each frame that the page
// draws; { kind: "call", id, name, arguments }, any method of Client. Messages from it: { kind: "joined", config };
// { kind: "frame", time, generation, positions, rotations, errorBounds, changed, events } with arrays that are the page's
// own, and with ids, shapes, kinds and tolerances when these changed; { kind: "answer", id, value };
// { kind: "error", id, error }.

import { wrong } from "./error.js";
import { RhumbError, connect } from "./rhumb.js";

let client;
let isConnecting = false;
let generation = -1;

function plain({ code, message, denial, closeCode, refusals, refusalsLeftOut }) {
  return { code: code ?? "argument", message, denial, closeCode, refusals, refusalsLeftOut };
}

function events() {
  const found = [];
  for (let event = client.pollEvent(); event !== undefined; event = client.pollEvent()) {
    found.push(event.error === undefined ? event : { ...event, error: plain(event.error) });
  }
  return found;
}

function frame() {
  let time;
  try {
    time = client.poll();
  } catch (error) {
    // A refusal comes after the view is computed; a client that has ended has its last view and events.
    postMessage({ kind: "error", error: plain(error) });
    time = client.view.time;
  }
  const { view } = client;
  const message = {
    kind: "frame",
    time,
    generation: view.generation,
    positions: view.positions.slice(),
    rotations: view.rotations.slice(),
    errorBounds: view.errorBounds.slice(),
    changed: view.changed.slice(),
    events: events(),
  };
  if (view.generation !== generation) {
    generation = view.generation;
    message.ids = view.ids.slice();
    message.shapes = view.shapes.slice();
    message.kinds = view.kinds.slice();
    message.tolerances = view.tolerances.slice();
  }
  const arrays = Object.values(message).filter(ArrayBuffer.isView);
  postMessage(message, arrays.map((array) => array.buffer));
}

async function begin(url, options, scene, join) {
  if (isConnecting || (client !== undefined && client.state !== "ended")) {
    throw new RhumbError({ code: "notNow", message: "this worker has a client already, or connects one" });
  }
  isConnecting = true;
  try {
    client = await (await connect(url, options)).join(scene, join);
    generation = -1;
  } finally {
    isConnecting = false;
  }
  postMessage({ kind: "joined", config: client.config });
}

async function perform({ kind, id, url, options, scene, join, name, arguments: given = [] }) {
  if (client === undefined && kind !== "connect") {
    throw new RhumbError({ code: "notNow", message: `the message ${kind} needs a client: send connect first, and wait for joined` });
  }
  switch (kind) {
    case "connect":
      return begin(url, options, scene, join);
    case "frame":
      return frame();
    case "call":
      return postMessage({ kind: "answer", id, value: await client[name](...given) });
    default:
      throw wrong("kind", kind, '"connect", "frame" or "call"');
  }
}

addEventListener("message", ({ data }) => {
  perform(data ?? {}).catch((error) => postMessage({ kind: "error", id: data?.id, error: plain(error) }));
});
