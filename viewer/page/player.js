// Plays recordings: files that are opened or dropped, and those that a page without a server has beside it.

import { readAddress, writeAddress } from "./address.js";
import { offer, onChoice } from "./controls.js";
import { openRecording } from "./recording.js";
import { number } from "./text.js";

/** Recordings that this page has beside it, if it is one without a server: addresses from the page's. */
export const OWN_RECORDINGS = JSON.parse(document.querySelector('meta[name="rhumb-recordings"]')?.content ?? "[]");

export class Player {
  #element;
  #asked = readAddress(location.search);
  /** The file that is played, whichever of its loads. */
  #file;
  #at = 0;
  isPaused = false;
  /** The load and run of the file that is played; undefined before there is one. */
  recording;
  /** Called with a recording that begins. */
  onbegin = () => {};
  /** Called with a sentence about what happens. */
  onhint = () => {};

  constructor(element) {
    this.#element = element;
    const open = (file) => file && this.open(file.name, () => file.arrayBuffer());
    element("recording").addEventListener("change", ({ target }) => open(target.files[0]));
    // Anywhere on the page: where a drop is not handled, the browser leaves the page for the file.
    document.addEventListener("dragover", (event) => event.preventDefault());
    document.addEventListener("drop", (event) => {
      event.preventDefault();
      open(event.dataTransfer.files[0]);
    });
    onChoice(element("load"), (load) => {
      writeAddress({ load, run: undefined });
      this.#play(load);
    });
    onChoice(element("run"), (run) => {
      writeAddress({ load: this.recording.load, run });
      this.#play(this.recording.load, run);
    });
  }

  /** Opens a file and plays the load and the run that the address names, or its first ones. */
  async open(name, read) {
    try {
      this.onhint(`Reading ${name}`);
      this.#file = await openRecording(name, await read());
      this.#play(this.#asked.load, this.#asked.run);
    } catch (cause) {
      this.onhint(`${name} cannot be played: ${cause.message}`);
    }
  }

  /** Offers the page's own recordings, and plays the one that the address names, or the first. */
  async playOwn() {
    const names = OWN_RECORDINGS.map((path) => decodeURIComponent(path.split("/").at(-1)));
    const begin = (name) =>
      this.open(name, async () => {
        const response = await fetch(OWN_RECORDINGS[names.indexOf(name)]);
        if (!response.ok) throw new Error(`the web server answers ${response.status} ${response.statusText}`);
        return response.arrayBuffer();
      });
    const first = names.includes(this.#asked.scene) ? this.#asked.scene : names[0];
    offer(this.#element("scene"), names, first);
    this.#element("scene-choice").hidden = names.length < 2;
    onChoice(this.#element("scene"), (scene) => {
      this.#asked = {};
      writeAddress({ scene, load: undefined, run: undefined });
      begin(scene);
    });
    await begin(first);
  }

  #play(load, run) {
    this.recording = this.#file.recording(load, run);
    this.#at = 0;
    this.isPaused = false;
    const { loads } = this.#file;
    const { runs } = loads.find(({ name }) => name === this.recording.load);
    offer(this.#element("load"), loads.map(({ name }) => name), this.recording.load);
    offer(this.#element("run"), runs, this.recording.run);
    this.#element("load-choice").hidden = loads.length < 2;
    this.#element("run-choice").hidden = runs.length < 2;
    this.onbegin(this.recording);
  }

  /** Pauses or continues; at the end, starts from the beginning. */
  togglePause() {
    this.isPaused = !this.isPaused;
    if (!this.isPaused && this.#at >= this.recording.length) this.#at = 0;
  }

  /** Moves to a time of the recording, seconds, and pauses. */
  scrub(at) {
    if (!this.isPaused) this.togglePause();
    this.#at = Math.max(0, Math.min(this.recording.length, at));
    this.#element("scrubber").value = Math.round(1000 * this.#at);
  }

  /** Moves forward or back by ticks, and pauses. */
  step(ticks) {
    this.scrub(this.#at + ticks * this.recording.step);
  }

  /** Plays on by seconds; returns the present time of the recording, and what is shown then. At its end it begins anew. */
  advance(seconds) {
    const { length } = this.recording;
    if (!this.isPaused) this.#at = this.#at >= length ? 0 : Math.min(length, this.#at + seconds);
    const scrubber = this.#element("scrubber");
    scrubber.max = Math.round(1000 * length);
    if (!this.isPaused) scrubber.value = Math.round(1000 * this.#at);
    this.#element("moment").textContent = `${number(this.#at, 1)} of ${number(length, 1)} s`;
    return { seconds: this.#at, ...this.recording.at(this.#at) };
  }
}
