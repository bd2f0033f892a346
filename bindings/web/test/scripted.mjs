// A server for tests in Node, which has no WebTransport: it sends what a test has it send, from spec/vectors/.

import { readFile } from "node:fs/promises";

const vectors = async (name) => JSON.parse(await readFile(new URL(`../../../spec/vectors/${name}`, import.meta.url)));

export const bytesOf = (digits) => Uint8Array.from(Buffer.from(digits, "hex"));

/** The recorded streams: each has a `name` and its `events`. */
export const streams = (await vectors("streams.json")).streams;

const messages = (await vectors("control.json"))["server messages"];

/** The bytes of a message of the server, by its name in control.json. */
export function message(name) {
  const found = messages.find((message) => message.name === name);
  if (found === undefined) throw new Error(`control.json has no message ${name}`);
  return bytesOf(found.bytes);
}

/** The events of a stream up to its first recorded state: a member has joined then. */
export function beginning(name) {
  const { events } = streams.find((stream) => stream.name === name);
  return events.slice(0, events.findIndex(([kind]) => kind === "known"));
}

/** The client's end of a connection to a server that sends what the test has it send. */
export class ScriptedTransport {
  #control;
  #datagrams;
  #close;
  ready = Promise.resolve();
  closed = new Promise((resolve) => (this.#close = resolve));
  datagrams = {
    readable: new ReadableStream({ start: (controller) => (this.#datagrams = controller) }),
    writable: new WritableStream(),
  };

  async createBidirectionalStream() {
    const readable = new ReadableStream({ start: (controller) => (this.#control = controller) });
    return { readable, writable: new WritableStream() };
  }

  sendControl(bytes) {
    this.#control.enqueue(bytes);
  }

  sendDatagram(bytes) {
    this.#datagrams.enqueue(bytes);
  }

  /** Sends events of a recorded stream. */
  play(events) {
    for (const [kind, value] of events) {
      if (kind === "control") this.sendControl(bytesOf(value));
      else if (kind === "datagram") this.sendDatagram(bytesOf(value));
    }
  }

  close({ closeCode = 0 } = {}) {
    this.#close({ closeCode });
  }
}
