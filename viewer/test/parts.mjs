// Parts of the page that need no browser: what a sender of full states sends, what an address says, what a number needs to be
// understood.
//
// Usage: node parts.mjs

import { readAddress, linkText } from "../page/address.js";
import { decompressLz4 } from "../page/lz4.js";
import { explanation } from "../page/headline.js";
import { Sender, STATE_BYTES } from "../page/sender.js";
import { check } from "./support.mjs";

/** A tick of bodies along a line, each with its place as x; those of `moved` a metre higher for each tick. */
function tickOf(layout, tick, moved) {
  const positions = new Float32Array(3 * layout.ids.length);
  const rotations = new Float32Array(4 * layout.ids.length);
  layout.ids.forEach((_, place) => {
    positions[3 * place] = place;
    positions[3 * place + 1] = moved.includes(place) ? tick : 0;
    rotations[4 * place + 3] = 1;
  });
  return { tick, positions, rotations, layout };
}

function layoutOf(ids, movable) {
  return { ids, movable, places: new Map(ids.map((id, place) => [id, place])) };
}

function aSenderKeepsItsBytes() {
  const layout = layoutOf([10, 11, 12, 13, 14, 15], [1, 2, 3, 4, 5]);
  const moved = [1, 2, 3, 4];
  const sender = new Sender();
  check(sender.send(tickOf(layout, 0, moved), 0).length === 0, "where bodies begin is known for nothing");
  let bytes = 0;
  const sent = [];
  for (let tick = 1; tick <= 40; tick++) {
    const more = (tick * 37) % 50;
    bytes += more;
    sent.push(...sender.send(tickOf(layout, tick, moved), more));
  }
  check(sent.length === Math.floor(bytes / STATE_BYTES), `${bytes} bytes are ${sent.length} states`);
  check(!sent.includes(0) && !sent.includes(5), "bodies that have not moved are not sent");
  const turns = moved.map((place) => sent.filter((other) => other === place).length);
  check(Math.max(...turns) - Math.min(...turns) <= 1, `the others take turns: ${turns}`);
  const last = sent.lastIndexOf(4);
  check(sender.positions[3 * 4 + 1] > 0 && last >= 0, "a body stands where its last state has it");
}

function unusedBytesAreLost() {
  const layout = layoutOf([0, 1, 2, 3], [0, 1, 2, 3]);
  const sender = new Sender();
  sender.send(tickOf(layout, 0, []), 0);
  sender.send(tickOf(layout, 1, []), 100 * STATE_BYTES);
  const sent = sender.send(tickOf(layout, 2, [0, 1, 2, 3]), 0);
  check(sent.length <= 1, "bytes that were not used cannot be used later");
}

function bodiesThatComeAndGoKeepTheOthers() {
  const before = layoutOf([0, 1, 2], [0, 1, 2]);
  const sender = new Sender();
  sender.send(tickOf(before, 0, []), 0);
  sender.send(tickOf(before, 5, [2]), STATE_BYTES);
  const after = layoutOf([2, 7], [0, 1]);
  sender.send(tickOf(after, 9, [0, 1]), 0);
  check(sender.positions[1] === 5, "a body that is still there stands where its last state has it");
  check(sender.positions[4] === 9, "a new one stands where it began");
}

function addressesAreValidated() {
  const whole = readAddress("?scene=a/b&tolerance=0.02&link=delay=100ms,loss=5%25&load=n500&run=rhumb");
  check(
    whole.scene === "a/b" && whole.tolerance === 0.02 && whole.load === "n500" && whole.run === "rhumb",
    "an address names scene, tolerance, load and run",
  );
  check(linkText(whole.link) === "delay=100ms,loss=5%", "and the link, as it would be written");
  check(linkText(readAddress("?link=delay=100ms,loss=5%").link) === "delay=100ms,loss=5%", "a bare percent sign is one too");
  check(linkText(readAddress("?link=").link) === "", "an empty link is a perfect one");
  for (const wrong of [
    "tolerance=0", "tolerance=2", "tolerance=-0.05", "tolerance=x", "tolerance=NaN", "tolerance=1e-2", "tolerance=",
    "link=lag=1ms", "link=delay=100", "link=delay=501ms", "link=loss=31%25", "link=rate=1mbit", "link=toString=1ms", "link=delay",
    "link=delay=100ms,delay=5ms", "tolerence=0.02", "show=present",
  ]) {
    const found = readAddress(`?${wrong}`);
    const isLeftOut = found.tolerance === undefined && found.link === undefined;
    if (!isLeftOut || found.wrong.length !== 1) throw new Error(`${wrong} is taken as ${JSON.stringify(found)}`);
  }
  check(true, "what is wrong is left out, and said");
  const twice = readAddress("?tolerance=0.02&tolerance=0.5");
  check(twice.tolerance === 0.02 && twice.wrong.length === 1, "of two values the first counts, and that is said");
}

/** Whatever is shown: an error beyond the tolerance has its sentence, and one within it has none of those. */
function noNumberContradictsAnother() {
  for (const moment of ["complete", "predicted", "newest", "recorded"]) {
    const said = explanation(true, { moment, errorScale: 1, waiting: 0 });
    check(/^More than the tolerance/.test(said), `${moment}: ${said}`);
    if (explanation(false, { moment, errorScale: 1, waiting: 0 }) !== undefined) throw new Error(`${moment} explains nothing`);
  }
  check(/3\.0 tolerances/.test(explanation(true, { moment: "complete", errorScale: 3 })), "a stream over its budget says so");
  check(/90 ticks/.test(explanation(false, { moment: "complete", errorScale: 1, waiting: 90 })), "a picture that waits says so");
}

/** A frame of one block: "abcd", then 20 bytes from four behind, then "end!!"; and one that is not packed. */
function framesOfLz4AreUnpacked() {
  const block = [0x4f, 0x61, 0x62, 0x63, 0x64, 0x04, 0x00, 0x01, 0x50, 0x65, 0x6e, 0x64, 0x21, 0x21];
  const head = [0x04, 0x22, 0x4d, 0x18, 0x60, 0x40, 0x82];
  const frame = Uint8Array.from([...head, block.length, 0, 0, 0, ...block, 2, 0, 0, 0x80, 0x68, 0x69, 0, 0, 0, 0]);
  const whole = "abcd".repeat(6) + "end!!hi";
  const text = new TextDecoder().decode(decompressLz4(frame, new Uint8Array(whole.length)));
  check(text === whole, `a frame of LZ4 is unpacked: ${text}`);
  let refused = 0;
  for (let length = 0; length < frame.length; length++) {
    try {
      decompressLz4(frame.subarray(0, length), new Uint8Array(whole.length));
    } catch (cause) {
      if (!(cause instanceof RangeError)) throw cause;
      refused++;
    }
  }
  check(refused === frame.length, "every frame that is cut is refused");
  for (let at = 0; at < frame.length; at++) {
    for (const value of [0, 1, 127, 255]) {
      const wrong = frame.slice();
      wrong[at] = value;
      try {
        decompressLz4(wrong, new Uint8Array(whole.length));
      } catch (cause) {
        if (!(cause instanceof RangeError)) throw cause;
      }
    }
  }
  check(true, "a damaged one is refused, or unpacked to as many bytes");
}

framesOfLz4AreUnpacked();
aSenderKeepsItsBytes();
unusedBytesAreLost();
bodiesThatComeAndGoKeepTheOthers();
addressesAreValidated();
noNumberContradictsAnother();
