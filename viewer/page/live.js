// The live connection: a copy of a scene, and beside it the truth as a stream of every state. Comes back by itself.

import { connect, isSupported } from "./client/rhumb.js";
import { sentence } from "./text.js";
import { Truth } from "./truth.js";

/** Pause before the next attempt to connect, milliseconds: the first one, and the longest. */
const PAUSE_FIRST = 500;
const PAUSE_MAX = 4000;
/** Time for which a copy follows its scene to another server, or comes back to this one, before it is joined anew, seconds. */
const RESUME_WITHIN = 4;

const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

/** The fault of this browser or this address, as a title and a sentence that says what to do; undefined without one. */
export function obstacle() {
  if (!globalThis.isSecureContext) {
    const here = `${location.protocol}//${location.host}`;
    return [
      "The browser does not let this page connect",
      `${here} is not a secure address. Open the page on the server's own machine by http://127.0.0.1, forward the port ` +
        "to your machine (ssh -L), or put an https server in front of it.",
    ];
  }
  if (!isSupported) {
    return [
      "This browser has no WebTransport",
      "Open this page in Chrome or Edge 123, Firefox 128, Safari 26.4, or a newer one.",
    ];
  }
  return undefined;
}

export class Live {
  /** Called with a state ("connecting", "open", "lost") and a sentence. */
  onstate = () => {};
  /** Called whenever a copy has been joined. */
  onjoin = () => {};
  /** The server's facts of `connect.json`; undefined before it was reached. */
  facts;
  copy;
  /** The truth of the same scene; undefined while it is not compared. */
  truth;
  #truthClient;
  /** The options of the next join. */
  options = { tolerance: 0.05, delayTicks: 1, truth: true };
  #scene;
  /** Grows with each change of the scene; attempts of an earlier one end. */
  #attempt = 0;

  /** Reads the facts of the server. */
  async read() {
    const response = await fetch("connect.json", { cache: "no-store" });
    if (!response.ok) throw new Error(await response.text());
    this.facts = await response.json();
    return this.facts;
  }

  /** Follows a scene from now on; ends only when another one is followed. */
  async follow(scene) {
    const attempt = ++this.#attempt;
    this.#scene = scene;
    this.close();
    for (let wait = PAUSE_FIRST; attempt === this.#attempt; wait = Math.min(2 * wait, PAUSE_MAX)) {
      try {
        this.onstate("connecting", `Connecting to ${scene}`);
        await this.read();
        const copy = await this.#join(this.facts.conditionedUrl, { within: this.options.tolerance });
        if (attempt !== this.#attempt) return copy.close();
        this.copy = copy;
        this.onjoin(copy);
        if (this.options.truth) await this.showTruth(true);
        if (attempt !== this.#attempt) return this.close();
        wait = PAUSE_FIRST / 2;
        this.onstate("open", `Following ${scene}`);
        const ending = await copy.closed;
        if (attempt !== this.#attempt) return;
        this.close();
        this.onstate("lost", sentence(ending.message));
      } catch (cause) {
        if (attempt !== this.#attempt) return;
        this.close();
        this.onstate("lost", explained(cause, this.facts?.conditionedUrl));
      }
      await pause(wait);
    }
  }

  async #join(url, stream) {
    const { certificateHashes, token } = this.facts;
    const connection = await connect(url, {
      certificateHashes,
      token,
      wasm: new URL("./client/rhumb.wasm", import.meta.url),
    });
    const { delayTicks } = this.options;
    // Whole ticks without glides: what is shown can be compared with the truth.
    const shown = { stream, delayTicks, wholeTicks: true, smooth: false };
    return connection.join(this.#scene, { ...shown, resumeWithin: RESUME_WITHIN, refusals: "events" });
  }

  /** Begins or ends the comparison with the truth, which takes the direct way: its link is not conditioned. */
  async showTruth(shown) {
    this.options.truth = shown;
    if (!shown) {
      this.#truthClient?.close();
      this.truth = this.#truthClient = undefined;
    } else if (this.truth === undefined && this.copy !== undefined) {
      const copy = this.copy;
      const client = await this.#join(this.facts.url, "full");
      if (copy !== this.copy || !this.options.truth) return client.close();
      this.#truthClient = client;
      this.truth = new Truth(client);
      // Without the truth the copy continues alone.
      client.closed.then(() => {
        if (this.#truthClient === client) this.truth = this.#truthClient = undefined;
      });
    }
  }

  close() {
    this.copy?.close();
    this.#truthClient?.close();
    this.copy = this.truth = this.#truthClient = undefined;
  }
}

/** Sentences about a failure, with what to do. */
function explained(cause, url) {
  if (cause instanceof TypeError) return "The server does not answer. Is it running?";
  if (cause.code === "connect") {
    return (
      `${url} was not reached. Does the server run, and does UDP pass to that port? If the server has another certificate ` +
      "than it named to this page, or does not allow pages of this address (web_origins in its configuration), it is " +
      "refused as well."
    );
  }
  return sentence(cause.message);
}
