// A sender of full states, given the bytes that Rhumb uses: what its viewers would see.
//
// The page computes it from the truth. The sender has the bodies' whole states, 56 bytes each, and sends them in turn, as many
// as the bytes of this moment allow. A viewer shows each body where its last state has it. Everything that is open favours
// the sender: it leaves out bodies that are where their last state says, it loses nothing, its states arrive in the tick that
// they are of, packets have no header, and where a body begins is known for nothing.

/** Bytes of a state: the body's id and 13 numbers of four bytes. */
export const STATE_BYTES = 56;

export class Sender {
  #cursor = 0;
  #bytes = 0;
  #layout;
  /** Of each place of the layout: the last state, and its tick. */
  positions = new Float32Array(0);
  rotations = new Float32Array(0);
  ticks = new Float64Array(0);

  /** The bodies that it sends: `ids`, `movable`, `places` by id. */
  get layout() {
    return this.#layout;
  }

  /** Sends what `bytes` more allow of the states of a tick; returns the places that it sent. */
  send({ tick, positions, rotations, layout }, bytes) {
    if (layout !== this.#layout) this.#take(layout, tick, positions, rotations);
    this.#bytes += bytes;
    const sent = [];
    const { movable } = layout;
    for (let looked = 0; looked < movable.length; looked++) {
      if (this.#bytes < STATE_BYTES) return sent;
      if (this.#cursor >= movable.length) this.#cursor = 0;
      const place = movable[this.#cursor++];
      if (this.#isAt(place, positions, rotations)) continue;
      this.#put(place, positions, rotations);
      this.ticks[place] = tick;
      this.#bytes -= STATE_BYTES;
      sent.push(place);
    }
    // Everything was looked at: a link does not keep the bytes that were not used.
    this.#bytes = Math.min(this.#bytes, STATE_BYTES);
    return sent;
  }

  /** Puts a body where it is, for nothing: it has come or gone. */
  place(place, { positions, rotations }) {
    this.#put(place, positions, rotations);
  }

  /** Other bodies: those that were there stay where their last states have them. */
  #take(layout, tick, positions, rotations) {
    const before = { layout: this.#layout, positions: this.positions, rotations: this.rotations, ticks: this.ticks };
    this.#layout = layout;
    this.positions = positions.slice();
    this.rotations = rotations.slice();
    this.ticks = new Float64Array(layout.ids.length).fill(tick);
    if (before.layout === undefined) return;
    for (const place of layout.movable) {
      const old = before.layout.places.get(layout.ids[place]);
      if (old === undefined) continue;
      for (let part = 0; part < 3; part++) this.positions[3 * place + part] = before.positions[3 * old + part];
      for (let part = 0; part < 4; part++) this.rotations[4 * place + part] = before.rotations[4 * old + part];
      this.ticks[place] = before.ticks[old];
    }
  }

  #isAt(place, positions, rotations) {
    for (let at = 3 * place; at < 3 * place + 3; at++) if (positions[at] !== this.positions[at]) return false;
    for (let at = 4 * place; at < 4 * place + 4; at++) if (rotations[at] !== this.rotations[at]) return false;
    return true;
  }

  #put(place, positions, rotations) {
    for (let at = 3 * place; at < 3 * place + 3; at++) this.positions[at] = positions[at];
    for (let at = 4 * place; at < 4 * place + 4; at++) this.rotations[at] = rotations[at];
  }
}
