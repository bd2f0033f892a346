// One WebTransport session to a server: the control stream, datagrams, and the end. Interprets no bytes.

import { RhumbError, wrong } from "./error.js";

/** Datagrams that wait to be read: a burst of a second. The browser's own limit is one. */
const INCOMING_DATAGRAMS = 1024;

/** The port of an address that names none (PROTOCOL 12). */
const PORT = 4433;
/** The path that names the protocol (PROTOCOL 1.5). */
const PATH = "/rhumb/1";

/** Rejects when the signal is aborted or the time is over; otherwise as `promise`. */
export function within(promise, timeout, awaited, signal) {
  return new Promise((resolve, reject) => {
    const late = () => {
      const message = `the server gave no ${awaited} within ${timeout} ms: check that it runs and that UDP passes`;
      reject(new RhumbError({ code: "timeout", message }));
    };
    const aborted = () => reject(new RhumbError({ code: "aborted", message: "the attempt was cancelled" }));
    const timer = setTimeout(late, timeout);
    if (signal?.aborted) aborted();
    else signal?.addEventListener("abort", aborted, { once: true });
    // Also if the signal was aborted before: a rejection must not be left unhandled.
    promise.then(resolve, reject).finally(() => {
      clearTimeout(timer);
      signal?.removeEventListener("abort", aborted);
    });
  });
}

function bytesOf(hash) {
  if (hash instanceof ArrayBuffer || ArrayBuffer.isView(hash)) return hash;
  if (!/^[0-9a-f]{64}$/i.test(hash)) {
    throw wrong("a hash of certificateHashes", hash, "bytes, or 64 hexadecimal digits as the server prints them");
  }
  return Uint8Array.from(hash.match(/../g), (digits) => parseInt(digits, 16));
}

async function optionsOf({ certificateHashes, print }) {
  let hashes = typeof certificateHashes === "function" ? await certificateHashes() : certificateHashes;
  // A browser that pins nothing asks an authority, by which the fingerprint of its certificate could not be pinned.
  if (hashes?.length && print !== undefined) hashes = [...hashes, print];
  const options = { allowPooling: false, congestionControl: "low-latency", requireUnreliable: true };
  if (hashes?.length) {
    options.serverCertificateHashes = hashes.map((hash) => ({ algorithm: "sha-256", value: bytesOf(hash) }));
  }
  return options;
}

/** The page's origin as a sentence names it; without one the page is of Node. */
function ofPage() {
  const origin = globalThis.location?.origin;
  return origin === undefined ? " this page" : ` pages of ${origin}`;
}

/** The URL and the fingerprint of a server that another one has named (PROTOCOL 3.7); undefined for an address that is none. */
export function placeOf(address) {
  const found = /^(?:rhumb:\/\/)?([^/#]+)(?:#([0-9a-f]{64}))?$/i.exec(address ?? "");
  if (!found) return undefined;
  const [, host, print] = found;
  try {
    return { url: serverUrl(`https://${/:\d+$/.test(host) ? host : `${host}:${PORT}`}`), print };
  } catch {
    return undefined;
  }
}

/** The address of a server as a WebTransport URL. */
export function serverUrl(url) {
  let parsed;
  try {
    parsed = new URL(url);
  } catch {
    throw new RhumbError({ code: "argument", message: `url: ${JSON.stringify(String(url))} is not https://host:port` });
  }
  if (parsed.protocol !== "https:") {
    throw new RhumbError({ code: "argument", message: `url: ${parsed.href} must begin with https://` });
  }
  if (parsed.pathname === "/") parsed.pathname = PATH;
  return parsed.href;
}

export class Connection {
  #transport;
  #control;
  #datagrams;
  #ended = false;
  #closing = false;
  /** Called with what arrives, and once with the end: `control(bytes)`, `datagram(bytes)`, `ended(closeCode or undefined)`. */
  handler;
  /** Events that arrived before there was a handler. */
  #early = [];
  counters = {
    receivedDatagrams: 0,
    receivedDatagramBytes: 0,
    receivedControlBytes: 0,
    sentDatagrams: 0,
    sentDatagramBytes: 0,
    sentControlBytes: 0,
  };

  /** Opens a session and its control stream. */
  static async open(url, options) {
    const Transport = options.transport ?? globalThis.WebTransport;
    if (Transport === undefined) {
      const message =
        "this browser has no WebTransport: use a present Chromium or Firefox, and a page from https or from this machine";
      throw new RhumbError({ code: "unsupported", message });
    }
    const connection = new Connection();
    const transport = new Transport(url, await optionsOf(options));
    connection.#transport = transport;
    // Their rejections are handled by `ready` below and by #read.
    transport.closed.catch(() => {});
    const opened = transport.ready.then(() => transport.createBidirectionalStream());
    try {
      const stream = await within(opened, options.timeout, "connection", options.signal);
      connection.#begin(stream);
    } catch (cause) {
      transport.close();
      if (cause instanceof RhumbError) throw cause;
      const message =
        `the server at ${url} gave no session: check that it runs, that UDP passes, that certificateHashes has its present ` +
        `hash, which it prints when it starts, and that it allows${ofPage()} by --web-origin (${cause.message})`;
      throw new RhumbError({ code: "connect", message }, { cause });
    }
    return connection;
  }

  #begin(stream) {
    const { datagrams } = this.#transport;
    if ("incomingHighWaterMark" in datagrams) datagrams.incomingHighWaterMark = INCOMING_DATAGRAMS;
    this.#control = stream.writable.getWriter();
    this.#datagrams = (datagrams.writable ?? datagrams.createWritable()).getWriter();
    this.#read(stream.readable, (bytes) => {
      this.counters.receivedControlBytes += bytes.length;
      this.#hand("control", bytes);
    });
    this.#read(datagrams.readable, (bytes) => {
      this.counters.receivedDatagrams += 1;
      this.counters.receivedDatagramBytes += bytes.length;
      this.#hand("datagram", bytes);
    });
    this.#transport.closed.then(
      ({ closeCode }) => this.#end(closeCode),
      () => this.#end(undefined),
    );
  }

  async #read(readable, hand) {
    const reader = readable.getReader();
    try {
      for (;;) {
        const { value, done } = await reader.read();
        if (done) return;
        hand(value);
      }
    } catch {
      // The end of the session, which `closed` tells, ends its streams.
    }
  }

  #hand(kind, bytes) {
    if (this.#ended || this.#closing) return;
    if (this.handler === undefined) this.#early.push([kind, bytes]);
    else this.handler[kind](bytes);
  }

  #end(closeCode) {
    if (this.#ended) return;
    this.#ended = true;
    if (this.handler === undefined) this.#early.push(["ended", closeCode]);
    else if (!this.#closing) this.handler.ended(closeCode);
  }

  /** Hands over what has arrived, and from now on what arrives. */
  start(handler) {
    this.handler = handler;
    for (const [kind, value] of this.#early.splice(0)) handler[kind](value);
  }

  sendControl(bytes) {
    this.counters.sentControlBytes += bytes.length;
    // A failed write is the end of the session, which `closed` tells.
    this.#control.write(bytes).catch(() => {});
  }

  sendDatagram(bytes) {
    this.counters.sentDatagrams += 1;
    this.counters.sentDatagramBytes += bytes.length;
    this.#datagrams.write(bytes).catch(() => {});
  }

  /** Closes with a code, after what was sent has left; the handler is not told. */
  async close(code) {
    if (this.#closing || this.#ended) return;
    this.#closing = true;
    try {
      await within(this.#control.close(), 500, "end of the control stream");
    } catch {
      // A server that does not take the last bytes loses them.
    }
    this.#transport.close({ closeCode: code, reason: "" });
  }
}
