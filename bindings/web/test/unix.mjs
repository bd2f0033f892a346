// A WebTransport for Node over the server's Unix socket (PROTOCOL 1.6).

import { connect } from "node:net";

const [CONTROL, STATE, END] = [0, 1, 2];
const HEAD_BYTES = 5;

/** The class of connections to a socket, for the option `transport` of `connect`. */
export function transportTo(path) {
  return class UnixTransport {
    #socket = connect(path);
    #waiting = Buffer.alloc(0);
    #control;
    #states;
    #onend;
    ready = new Promise((resolve, reject) => {
      this.#socket.once("connect", resolve);
      this.#socket.once("error", reject);
    });
    closed = new Promise((resolve, reject) => {
      this.#socket.once("close", () => reject(new Error("the connection broke")));
      this.#onend = (closeCode) => resolve({ closeCode });
    });
    datagrams = {
      readable: new ReadableStream({ start: (controller) => (this.#states = controller) }),
      writable: new WritableStream({ write: (bytes) => this.#send(STATE, bytes) }),
    };

    async createBidirectionalStream() {
      const readable = new ReadableStream({ start: (controller) => (this.#control = controller) });
      this.#socket.on("data", (bytes) => this.#receive(bytes));
      this.#socket.on("error", () => {});
      return { readable, writable: new WritableStream({ write: (bytes) => this.#send(CONTROL, bytes) }) };
    }

    #send(lane, bytes) {
      const head = Buffer.alloc(HEAD_BYTES);
      head.writeUInt8(lane, 0);
      head.writeUInt32LE(bytes.length, 1);
      this.#socket.write(Buffer.concat([head, bytes]));
    }

    #receive(bytes) {
      this.#waiting = Buffer.concat([this.#waiting, bytes]);
      while (this.#waiting.length >= HEAD_BYTES) {
        const end = HEAD_BYTES + this.#waiting.readUInt32LE(1);
        if (this.#waiting.length < end) return;
        const [lane, payload] = [this.#waiting[0], Uint8Array.from(this.#waiting.subarray(HEAD_BYTES, end))];
        this.#waiting = this.#waiting.subarray(end);
        if (lane === CONTROL) this.#control.enqueue(payload);
        else if (lane === STATE) this.#states.enqueue(payload);
        else this.#onend(new DataView(payload.buffer).getUint32(0, true));
      }
    }

    close({ closeCode = 0 } = {}) {
      const code = Buffer.alloc(4);
      code.writeUInt32LE(closeCode);
      this.#send(END, code);
      this.#socket.end();
    }
  };
}
