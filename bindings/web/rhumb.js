// Client of a remote physics scene in a browser. rhumb.d.ts documents every name.

import { Client } from "./client.js";
import { Connection, serverUrl } from "./connection.js";
import { load } from "./module.js";
import { RhumbError, checkNames, wrong } from "./error.js";

export { Client, RhumbError, load };
export { Member } from "./member.js";

export const TOLERANCE = Object.freeze({ exact: 0.005, fine: 0.02, normal: 0.05, coarse: 0.2 });

export const isSupported = typeof globalThis.WebTransport !== "undefined";

const TIMEOUT = 5000;
const OPTIONS = ["certificateHashes", "token", "signal", "timeout", "wasm", "transport"];

function check(options) {
  checkNames("options", options, OPTIONS);
  const { certificateHashes, token, signal, timeout, transport } = options;
  if (transport !== undefined && typeof transport !== "function") throw wrong("options.transport", transport, "a constructor");
  if (timeout !== undefined && !(timeout > 0 && timeout < Infinity)) {
    throw wrong("options.timeout", timeout, "milliseconds, finite and above 0");
  }
  if (token !== undefined && typeof token !== "string") throw wrong("options.token", token, "a text");
  if (signal !== undefined && !(signal instanceof AbortSignal)) throw wrong("options.signal", signal, "an AbortSignal");
  if (certificateHashes !== undefined && typeof certificateHashes !== "function" && !Array.isArray(certificateHashes)) {
    throw wrong("options.certificateHashes", certificateHashes, "a list of hashes, or a function that returns one");
  }
}

export async function connect(url, options = {}) {
  check(options);
  const href = serverUrl(url);
  const settings = { ...options, timeout: options.timeout ?? TIMEOUT };
  const [connection] = await Promise.all([Connection.open(href, settings), load(options.wasm)]);
  return new ServerConnection(connection, href, settings);
}

export class ServerConnection {
  #connection;
  #connecting;

  constructor(connection, url, options) {
    this.#connection = connection;
    const { token, timeout, signal } = options;
    this.#connecting = { url, options, token, timeout, signal };
  }

  async join(scene, options = {}) {
    if (options === null || typeof options !== "object") throw wrong("options", options, "an object");
    const connection = this.#connection;
    if (connection === undefined) {
      throw new RhumbError({ code: "notNow", message: "this connection has joined a scene or was closed: connect again" });
    }
    this.#connection = undefined;
    try {
      return await Client.join(connection, this.#connecting, scene, options);
    } catch (cause) {
      connection.close(0);
      throw cause;
    }
  }

  close() {
    this.#connection?.close(0);
    this.#connection = undefined;
  }
}
