// One of the two pictures: bodies with their colours, rings where updates arrive, and lines to where they should be.

import { Bodies } from "./bodies.js";
import { Offsets } from "./offsets.js";
import { Pulses } from "./pulses.js";
import { Trail } from "./trail.js";

export class Pane {
  picture;
  bodies;
  offsets;
  pulses;
  trail;
  #colours;
  #layout;
  #isStale = true;

  /** `picture`: its place on the stage; `colours`: those of all panes. */
  constructor(picture, colours) {
    this.picture = picture;
    this.#colours = colours;
    this.bodies = new Bodies(picture.scene);
    this.offsets = new Offsets(this.bodies);
    this.pulses = new Pulses(this.bodies);
    this.trail = new Trail(this.bodies);
  }

  /** Paints what is not a body: `ink` for marks, `off` for the lines of bodies that are off, `ground` for static bodies. */
  paint({ ink, off, ground }) {
    this.offsets.colour = off;
    this.pulses.colour = this.trail.colour = ink;
    this.bodies.staticColour = ground;
  }

  /** The bodies that are shown. */
  get layout() {
    return this.#layout;
  }

  /** Draws the next frame in full: it comes from another source. */
  forget() {
    this.#isStale = true;
  }

  /**
   * Shows a frame. `errors` of its bodies, where the truth is known; `judged`: poses and the truth of one tick, for the lines;
   * `picked`: the place of the picked body, or -1; `now` in seconds.
   */
  show(frame, { errors, judged, picked, now }) {
    const { layout } = frame;
    const isNew = this.#layout !== layout;
    if (isNew) {
      this.#layout = layout;
      this.bodies.layout(layout);
    }
    this.bodies.pose(frame, isNew || this.#isStale ? layout.ids.keys() : frame.changed);
    this.#isStale = false;
    this.#colours.apply(this.bodies, frame, errors, picked);
    this.offsets.show(judged?.shown, layout, errors, frame.tolerances, judged?.actual);
    this.pulses.show(frame, this.picture.height * Math.min(globalThis.devicePixelRatio, 2), now);
    this.trail.show(frame, picked);
  }
}
