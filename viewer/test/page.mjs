// The page in real browsers, over the real protocol, against `rhumb-server demo`.
//
// Usage: node page.mjs RHUMB_SERVER [--pictures FOLDER]. A browser that is missing, its driver or its display, is printed as
// skipped; without any the test passes. RHUMB_BROWSERS, with spaces between them, names those to try. No time is asserted:
// a frame that a slow machine does not draw is not compared.

import { execFileSync, spawn } from "node:child_process";
import { mkdtemp, rm } from "node:fs/promises";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { Missing, openChromium, openFirefox } from "./browsers.mjs";
import { check, choose, kill, openPage, read, slide, startDemo, startServer, text, until } from "./support.mjs";

const [binary, option, pictures] = process.argv.slice(2);
if (binary === undefined || (option !== undefined && option !== "--pictures")) {
  console.error("usage: node page.mjs RHUMB_SERVER [--pictures FOLDER]");
  process.exit(2);
}
const servers = new Set();
const start = async (options) => {
  const demo = await startDemo(binary, options);
  servers.add(demo);
  return demo;
};
const stop = async (demo) => {
  servers.delete(demo);
  await kill(demo);
};

const notice = (page) => page.evaluate(() => document.querySelector("#notice p").textContent);

async function ballsFallWithinTheTolerance(browser, { url }) {
  const page = await openPage(browser, url);
  await until(page, "d.state === 'open' && d.bodies === 500");
  const shown = await page.evaluate(() => document.getElementById("shown").value);
  check(shown === "complete", "the page opens on the newest complete tick");
  await fullStatesAreFurtherOff(page);
  // A processor draws one picture twice as fast, and loses less of the truth meanwhile.
  await besideIs(page, false);
  const before = await read(page);
  // From a fall over the burst until most of them rest.
  await until(page, `d.time > 420 && d.comparison.ticks >= ${before.ticks + 25} && d.moving < 250`);
  const counts = await read(page);
  check(counts.beyondTolerance === 0, `of ${counts.bodyTicks} displayed body-ticks none is beyond the tolerance`);
  check(counts.bodyTicks === 500 * counts.ticks, `all bodies of ${counts.ticks} ticks were compared`);
  const unjudged = counts.unjudged - before.unjudged;
  check(
    unjudged * 10 <= counts.ticks - before.ticks,
    `every displayed tick was compared, but ${unjudged} of which the browser lost the truth`,
  );
  check(
    counts.beyondBound === 0 && counts.boundedBodyTicks > 0,
    `nor one of ${counts.boundedBodyTicks} beyond its stated bound`,
  );
  check(
    counts.greatestShare > 0.2 && counts.greatestShare <= 1.002,
    `the greatest error is ${counts.greatestShare.toFixed(3)} tolerances`,
  );
  check(counts.moving < 250, "most balls come to rest");
  return page;
}

/** Shows full states beside the copy, or not, by the key. */
async function besideIs(page, isShown) {
  if ((await page.evaluate(() => document.getElementById("beside").checked)) !== isShown) await page.keyboard.press("KeyB");
  await until(page, `document.getElementById("pictures").classList.contains("two") === ${isShown}`);
}

/** The two pictures of the burst, and the two large numbers above them. */
async function fullStatesAreFurtherOff(page) {
  await until(page, "d.time > 110 && d.moving > 250 && d.sums.besideWorst > 1 && d.sums.worst > 0");
  const { sums } = await read(page);
  check(
    sums.worst < 0.0502 && sums.besideWorst > 20 * sums.worst,
    `with the same bytes, full states are off by ${sums.besideWorst.toFixed(2)} m, and the copy by ${sums.worst.toFixed(3)} m`,
  );
  check(sums.naive > 20 * sums.bytes, `full states of all would take ${(sums.naive / sums.bytes).toFixed(0)} times the bytes`);
  await until(page, () => /^[\d,]+×$/.test(document.getElementById("times").textContent));
  const worst = await text(page, "worst");
  check(/^\d[\d.]* (mm|cm)$/.test(worst), `the numbers say ${await text(page, "times")} and ${worst}`);
  const [beside, copy] = [await text(page, "beside-title"), await text(page, "copy-title")];
  check(/^Full states, same bytes: off by .* m$/.test(beside) && copy.startsWith("Rhumb: off by"), `${beside}. ${copy}`);
  check((await text(page, "legend")).includes("beyond the tolerance"), "the colours have words");
}

/** After the present moment was shown, the numbers are those of complete ticks alone. */
async function completeTicksNeedNoExcuse(page) {
  const { ticks } = await read(page);
  const beyond = await page.evaluate(async () => {
    let beyond = 0;
    for (let look = 0; look < 40; look++) {
      await new Promise((resolve) => setTimeout(resolve, 50));
      // The numbers are written four times a second.
      if (look > 10 && document.getElementById("worst").classList.contains("beyond")) beyond++;
    }
    return beyond;
  });
  await until(page, `d.comparison.ticks > ${ticks}`);
  check(beyond === 0, "complete ticks are shown within the tolerance at once");
}

/** The two large numbers never contradict each other without a sentence. */
async function beyondIsExplained(page) {
  const seen = await page.evaluate(async () => {
    const seen = { beyond: 0, within: 0, unexplained: 0, places: new Set() };
    const element = (id) => document.getElementById(id);
    for (let look = 0; look < 60; look++) {
      const isBeyond = element("worst").classList.contains("beyond");
      seen[isBeyond ? "beyond" : "within"]++;
      if (isBeyond && element("explanation").hidden) seen.unexplained++;
      seen.places.add(element("view").getBoundingClientRect().top);
      await new Promise((resolve) => setTimeout(resolve, 50));
    }
    return { ...seen, places: seen.places.size };
  });
  check(seen.places === 1, "the pictures stay where they are, whatever is said");
  check(seen.unexplained === 0, `an error beyond the tolerance has its sentence: seen ${seen.beyond} times of 60`);
}

async function aBadLinkStaysWithinTheStatedBounds(page) {
  await slide(page, "link-delay", 100);
  await slide(page, "link-loss", 5);
  await linkIs(page, "delay=100ms,loss=5%");
  // Not only the complete ticks: bodies of which a packet is missing have no bound.
  await choose(page, "shown", "newest");
  const before = await read(page);
  for (let ball = 0; ball < 4; ball++) {
    await page.evaluate(() => document.getElementById("throw").click());
    await until(page, `d.comparison.allBodyTicks > ${(await read(page)).allBodyTicks + 2000}`);
  }
  const after = await read(page);
  const losses = await page.evaluate(async () => (await (await fetch("link/counts")).json()).down.lost);
  check(losses > 0, `the relay has lost ${losses} datagrams of the page`);
  check(
    after.boundedBodyTicks > before.boundedBodyTicks,
    `${after.boundedBodyTicks - before.boundedBodyTicks} body-ticks have a stated bound`,
  );
  check(after.beyondBound === 0, "with 100 ms and 5 % loss, what is shown stays within its stated bounds");
  check(after.beyondTolerance === 0, "and complete ticks stay within the tolerance");
  await choose(page, "shown", "predicted");
  const { allBodyTicks, allBeyondTolerance } = await read(page);
  await until(page, `d.comparison.allBodyTicks > ${allBodyTicks + 5000}`);
  await beyondIsExplained(page);
  const predicted = await read(page);
  const off = predicted.allBeyondTolerance - allBeyondTolerance;
  check(
    predicted.beyondBound === 0,
    `the present moment is predicted: ${off} of ${predicted.allBodyTicks - allBodyTicks} body-ticks are beyond the tolerance, ` +
      "and none beyond a stated bound",
  );
  await choose(page, "shown", "complete");
  await completeTicksNeedNoExcuse(page);
  await slide(page, "link-jitter", 20);
  await slide(page, "link-rate", 2);
  await linkIs(page, "delay=100ms,jitter=20ms,loss=5%,rate=5000000bit");
  const { ticks } = await read(page);
  await until(page, `d.comparison.ticks > ${ticks + 2}`);
  check((await read(page)).beyondTolerance === 0, "with jitter and a limited rate, complete ticks stay within it");
  await page.evaluate(() => document.getElementById("link-clear").click());
}

/** Waits until the server's relay has a condition. */
async function linkIs(page, condition) {
  for (let tries = 0; tries < 200; tries++) {
    const link = await page.evaluate(async () => (await fetch("link")).text());
    if (link === condition) return;
    await page.waitForTimeout(50);
    if (tries === 199) throw new Error(`the link is ${link}, not ${condition}`);
  }
}

async function handsWork(page) {
  await until(page, "d.state === 'open'");
  const box = await aBoxIsDropped(page);
  check(box !== undefined, "a key drops a box");
  await page.keyboard.press("Delete");
  await until(page, `!d.shown.ids.includes(${box})`);
  check(true, "a key removes it");
  await page.evaluate(() => document.querySelector("[data-tolerance='0.02']").click());
  await until(page, () => document.getElementById("tolerance-shown").textContent === "20.0 mm");
  const { allBodyTicks } = await read(page);
  await until(page, `d.comparison.allBodyTicks > ${allBodyTicks + 1000}`);
  const counts = await read(page);
  check(counts.beyondTolerance === 0, "another tolerance holds as well");
  await bodiesAreCarried(page);
}

/** Drops a box; resolves with its id as soon as it is shown. */
async function aBoxIsDropped(page) {
  // The demo removes what visitors have added, now and then: a box may be gone before it is shown.
  for (let attempt = 0; attempt < 3; attempt++) {
    const before = await page.evaluate(() => rhumbDiagnostics.lastAdded);
    await page.keyboard.press("KeyN");
    await until(page, `d.lastAdded !== ${before}`);
    const id = await page.evaluate(() => rhumbDiagnostics.lastAdded);
    for (let tries = 0; tries < 200; tries++) {
      if ((await bodyAt(page, id)) !== undefined) return id;
      await page.waitForTimeout(50);
    }
  }
  return undefined;
}

/** A body of the frame that is shown. */
const bodyAt = (page, id) =>
  page.evaluate((id) => {
    const { ids, positions, time } = rhumbDiagnostics.shown;
    const place = ids.indexOf(id);
    return place < 0 ? undefined : { time, position: Array.from(positions.subarray(3 * place, 3 * place + 3)) };
  }, id);

/**
 * Where a body that can move is seen in the copy's picture, pixels of the page: one at rest if there is one, with room above;
 * undefined if none is seen. `attempt`: another number, another body.
 */
const aBodyInSight = (page, attempt) =>
  page.evaluate((attempt) => {
    const d = rhumbDiagnostics;
    const canvas = document.getElementById("view");
    const { top, height } = canvas.getBoundingClientRect();
    const inSight = [];
    const { kinds, layout, resting } = d.shown;
    const movable = layout?.movable ?? Array.from(kinds).flatMap((kind, place) => (kind === 0 ? [] : [place]));
    for (const place of movable) {
      if (d.drawnPosition(place) === undefined) continue;
      const [x, y] = d.screenOf(place);
      if (y < top + 0.35 * height || document.elementFromPoint(x, y) !== canvas) continue;
      inSight.push({ x, y, isResting: resting[place] });
    }
    inSight.sort((one, other) => other.isResting - one.isResting);
    return inSight[attempt % Math.max(1, inSight.length)];
  }, attempt);

async function bodiesAreCarried(page) {
  const { height } = await page.evaluate(() => document.getElementById("view").getBoundingClientRect().toJSON());
  // The present moment advances at each frame; a complete tick may be long in coming.
  await choose(page, "shown", "predicted");
  // The bodies move, and go back now and then: another try may hit another one.
  let points = 0;
  for (let attempt = 0; attempt < 10 && points < 5; attempt++) {
    await aBodyIsClicked(page);
    for (let tries = 0; tries < 200 && points < 5; tries++) {
      await page.waitForTimeout(50);
      ({ points } = await page.evaluate(() => rhumbDiagnostics.trail));
    }
  }
  check((await text(page, "body-facts")).includes("predictor"), "a click shows a body's track");
  check(points >= 5, "and draws its way");
  let carried = { way: 0 };
  for (let attempt = 0; attempt < 20 && !(carried.way >= 1 && carried.isPicked); attempt++) {
    const { x, y } = await aBodyIsClicked(page, attempt);
    carried = await carry(page, x, y, 0.3 * height);
  }
  check(carried.way >= 1, "a body is carried with shift and the mouse");
  await until(page, "d.trail.marks > 0");
  check(true, "its way has a mark where an update began");
  await choose(page, "shown", "complete");
}

/**
 * Carries the body at a point of the screen upwards; resolves with the metres by which it has risen, at most one, and whether
 * it is the picked one. Without a body there nothing is moved: the mouse would move the camera.
 */
async function carry(page, x, y, pixels) {
  await page.keyboard.down("Shift");
  await page.mouse.move(x, y);
  await page.mouse.down();
  const id = await page.evaluate(() => rhumbDiagnostics.carried);
  const before = id === undefined ? undefined : await bodyAt(page, id);
  if (before !== undefined) await page.mouse.move(x, y - pixels, { steps: 4 });
  let way = 0;
  for (let tries = 0; before !== undefined && tries < 100 && way < 1; tries++) {
    await page.waitForTimeout(50);
    const now = await bodyAt(page, id);
    if (now === undefined) break;
    way = Math.min(1, now.position[1] - before.position[1]);
  }
  await page.mouse.up();
  await page.keyboard.up("Shift");
  const isPicked = await page.evaluate((id) => id !== undefined && rhumbDiagnostics.picked === id, id);
  return { way, isPicked };
}

/** Clicks on bodies of the copy's picture, one after another, until one is hit; resolves with where. */
async function aBodyIsClicked(page, first = 0) {
  for (let attempt = first; attempt < first + 40; attempt++) {
    await until(page, "d.shown !== undefined");
    const at = await aBodyInSight(page, attempt);
    if (at !== undefined) {
      await page.mouse.click(at.x, at.y);
      if ((await page.evaluate(() => rhumbDiagnostics.picked)) !== undefined) return at;
    }
    await page.waitForTimeout(100);
  }
  throw new Error("no body is hit");
}

/** Lines lead from where bodies are shown to where the truth has them, and only from those that are far off. */
async function linesLeadToTheTruth(page) {
  await besideIs(page, true);
  await page.evaluate(() => document.getElementById("throw").click());
  const counts = () =>
    page.evaluate(() => {
      const lengths = (ends) => {
        const out = [];
        for (let at = 0; at < ends.length; at += 6)
          out.push(Math.hypot(ends[at] - ends[at + 3], ends[at + 1] - ends[at + 4], ends[at + 2] - ends[at + 5]));
        return out;
      };
      const { lines, besideLines } = rhumbDiagnostics;
      return { copy: lengths(lines()), beside: lengths(besideLines()) };
    });
  // A view that was ahead waits for complete ticks.
  const { ticks } = await read(page);
  await until(page, `d.comparison.ticks > ${ticks + 3} && d.comparison.isComplete && d.besideLines().length > 0`);
  const { copy, beside } = await counts();
  check(copy.every((length) => length <= 0.05 + 1e-3), `${copy.length} lines of the copy are within its tolerance`);
  check(beside.some((length) => length > 0.05), `of ${beside.length} lines of full states some are longer`);
  await page.keyboard.press("KeyG");
  await until(page, "d.besideLines().length === 0 && d.lines().length === 0");
  check(true, "a key takes them away");
  await page.keyboard.press("KeyG");
  await besideIs(page, false);
  check(true, "a key brings the second picture, and takes it away");
}

/** Keys act after a control was used by the mouse, and the control's own keys are its own while it is used by keys. */
async function keysWorkAfterAClick(page) {
  const value = (id) => page.evaluate((id) => document.getElementById(id).value, id);
  const press = async (id) => {
    await page.evaluate((id) => document.getElementById(id).scrollIntoView({ block: "center" }), id);
    const box = await page.evaluate((id) => document.getElementById(id).getBoundingClientRect().toJSON(), id);
    await page.mouse.click(box.left + box.width / 2, box.top + box.height / 2);
  };
  for (const id of ["flashes", "theme", "tolerance"]) {
    for (let twice = 0; twice < 2; twice++) {
      await press(id);
      const before = await value("colour");
      await page.keyboard.press("KeyC");
      if ((await value("colour")) === before) throw new Error(`after a click on ${id}, keys do nothing`);
    }
  }
  check(true, "keys work after a click on a box, a button, a slider");
  const focused = await page.evaluate(() => document.activeElement.id);
  check(focused === "view", "the scene has the keys again");
  await page.evaluate(() => document.getElementById("tolerance").focus());
  const before = await value("tolerance");
  await page.keyboard.press("ArrowRight");
  await until(page, `document.getElementById("tolerance").value !== ${JSON.stringify(before)}`);
  check(true, "a slider that is used by keys keeps its own");
  const colour = await value("colour");
  await page.keyboard.press("KeyC");
  check((await value("colour")) !== colour, "and leaves the others to the page");
  await choose(page, "colour", "error");
  await page.evaluate(() => {
    document.querySelector("[data-tolerance='0.05']").click();
    document.getElementById("view").focus();
    scrollTo(0, 0);
  });
}

/** Scene, tolerance and link are in the address, which opens the same again. */
async function theAddressIsShared(browser, { url }) {
  const asked = `${url}?scene=tumbler&tolerance=0.02&link=delay=60ms,loss=2%25`;
  const page = await openPage(browser, asked);
  await until(page, "d.state === 'open' && d.bodies > 0");
  const scene = await page.evaluate(() => document.getElementById("scene").value);
  check(scene === "tumbler" && (await text(page, "tolerance-shown")) === "20.0 mm", "the address names scene and tolerance");
  await linkIs(page, "delay=60ms,loss=2%");
  check(true, "and the link");
  await slide(page, "link-delay", 80);
  await page.evaluate(() => document.querySelector("[data-tolerance='0.2']").click());
  await choose(page, "scene", "ragdolls");
  await until(page, () => location.search === "?scene=ragdolls&tolerance=0.2&link=delay=80ms,loss=2%25");
  check(true, `what is changed is in the address: ${await page.evaluate(() => location.search)}`);
  await page.evaluate(() => document.getElementById("link-clear").click());
  await until(page, () => location.search === "?scene=ragdolls&tolerance=0.2");
  check(true, "a perfect link is not");
  check(page.errors.length === 0, `no error in the page ${page.errors.join("; ")}`);
  await page.close();
  const wrong = await openPage(browser, `${url}?scene=nowhere&tolerance=7&link=lag`);
  await until(wrong, "d.state === 'open'");
  const said = await text(wrong, "status");
  check(["nowhere", '"7"', '"lag"'].every((part) => said.includes(part)), `a wrong address is explained: ${said}`);
  check((await text(wrong, "tolerance-shown")) === "50.0 mm", "and the rest is as without it");
  await wrong.close();
}

/**
 * Frames that were shown live are shown again: the same bodies in the same places. One tick may have been shown more than
 * once, with what had arrived until then.
 */
async function theLastMinuteIsKept(page) {
  await page.evaluate(() => {
    const byTime = (globalThis.shownLive = new Map());
    let { frames } = rhumbDiagnostics;
    // The page counts each frame when it is whole.
    Object.defineProperty(rhumbDiagnostics, "frames", {
      configurable: true,
      enumerable: true,
      get: () => frames,
      set(count) {
        frames = count;
        const { shown } = rhumbDiagnostics;
        if (shown === undefined || document.getElementById("moment").textContent !== "live") return;
        const { time, ids, positions } = shown;
        byTime.set(time, [...(byTime.get(time) ?? []), { ids: Array.from(ids), positions: Array.from(positions) }]);
      },
    });
    document.getElementById("throw").click();
  });
  await until(page, () => globalThis.shownLive.size >= 10);
  await page.keyboard.press("KeyP");
  // The first tick may have been shown before as well.
  await page.evaluate(() => globalThis.shownLive.delete(globalThis.shownLive.keys().next().value));
  check((await text(page, "moment")).endsWith("ago"), "the last minute can be looked at");
  let compared = 0;
  for (let back = 0; back < 8; back++) {
    await page.keyboard.press("ArrowLeft");
    await until(page, "d.shown !== undefined");
    const isSame = await page.evaluate(async () => {
      await new Promise(requestAnimationFrame);
      await new Promise(requestAnimationFrame);
      const { time, ids, positions } = rhumbDiagnostics.shown;
      const equal = (one, other) => one.length === other.length && one.every((value, at) => value === other[at]);
      return globalThis.shownLive.get(time)?.some((then) => equal(then.ids, ids) && equal(then.positions, positions));
    });
    if (isSame === undefined) continue;
    if (!isSame) throw new Error("a frame of the last minute is no frame that was shown live");
    compared++;
  }
  check(compared > 0, `${compared} frames are the same as when they were live`);
  await aBodyIsClicked(page);
  await until(page, () => document.getElementById("body-facts").textContent.includes("position"));
  check(true, "a body of the last minute is picked");
  for (let on = 0; on < 4; on++) await page.keyboard.press("ArrowRight");
  await until(page, "d.trail.points > 0");
  check(true, "and its way drawn");
  await page.keyboard.press("KeyP");
  check((await text(page, "moment")) === "live", "and left again");
}

/** Every colouring and the flashes by their keys. */
async function coloursFollowTheKeys(page) {
  const checked = (id) => page.evaluate((id) => document.getElementById(id).checked, id);
  await page.keyboard.press("Escape");
  await page.keyboard.press("KeyF");
  check(!(await checked("flashes")), "a key ends the flashes");
  for (let mode = 0; mode < 4; mode++) {
    const before = await page.evaluate(() => document.getElementById("colour").value);
    await page.keyboard.press("KeyC");
    const { frames } = await read(page);
    await until(page, `d.frames > ${frames + 2}`);
    const { now, colours, shapes } = await page.evaluate(() => {
      const { shown } = rhumbDiagnostics;
      const movable = Array.from(shown.kinds).flatMap((kind, place) => (kind === 0 ? [] : [place]));
      return {
        now: document.getElementById("colour").value,
        colours: [...new Set(rhumbDiagnostics.drawnColours().map((parts) => parts.map((part) => part.toFixed(2)).join()))],
        shapes: new Set(movable.map((place) => shown.shapes[place])).size,
      };
    });
    check(now !== before && colours.length > 0, `a key colours by ${now}`);
    // As light is added: the colours of the style sheet, #6b7889 and #f39422.
    const linear = (byte) => ((byte / 255 + 0.055) / 1.055) ** 2.4;
    const moves = [[0x6b, 0x78, 0x89], [0xf3, 0x94, 0x22]].map((parts) => parts.map((part) => linear(part).toFixed(2)).join());
    if (now === "rest") check(colours.every((colour) => moves.includes(colour)), "in the colours of rest and motion");
    if (now === "shape") check(colours.length === shapes, `in as many colours as there are shapes, ${shapes}`);
  }
  await page.keyboard.press("KeyF");
  check(await checked("flashes"), "and begins them");
  await page.evaluate(() => document.getElementById("throw").click());
  await until(page, "d.rings() > 0");
  check(true, "a ring shows where an update arrives");
}

/** A server with tokens: its page follows a scene of someone else, and may change nothing in it. */
async function aTokenOfTheServerObserves(browser) {
  const folder = await mkdtemp(join(tmpdir(), "rhumb-page-"));
  const key = join(folder, "key");
  const token = (...options) => execFileSync(binary, ["token", ...options], { encoding: "utf8" }).trim();
  token("--new-key", key);
  const owner = token("--key", key, "--client", "anna", "--scene", "team/*", "--role", "owner");
  const listens = ["--listen", "127.0.0.1:0", "--view", "127.0.0.1:0", "--log", "off"];
  const server = await startServer(binary, ["--token-key", `${key}.pub`, ...listens]);
  servers.add(server);
  const page = await openPage(browser, server.url);
  await until(page, () => document.querySelector("#notice h2").textContent === "The server has no scene yet");
  check(true, "a server without a scene says so");
  const facts = await (await fetch(new URL("connect.json", server.url))).json();
  await page.evaluate(
    async ({ url, certificateHashes, owner }) => {
      const { connect } = await import("/client/rhumb.js");
      const connection = await connect(url, { certificateHashes, token: owner });
      const scene = await connection.join("team/drop", { mode: { createOrJoin: { stepping: "freeRunning" } } });
      scene.addBody({ kind: "fixed", shape: { kind: "cuboid", halfExtents: [9, 0.5, 9] }, position: [0, -0.5, 0] });
      const ball = (at) => ({ kind: "dynamic", shape: { kind: "ball", radius: 0.5 }, position: [at - 5, 20 + at, 0] });
      scene.addBodies(Array.from({ length: 10 }, (_, at) => ball(at)));
      globalThis.owner = scene;
    },
    { ...facts, owner },
  );
  await until(page, "d.state === 'open' && d.bodies === 10 && d.comparison.allBodyTicks > 200");
  const counts = await read(page);
  check(counts.beyondBound === 0, "a page of a server with tokens follows the scene of another client");
  await page.keyboard.press("KeyN");
  await until(page, () => document.getElementById("status").textContent.includes("may not do that"));
  check(true, `and may not change it: ${await text(page, "status")}`);
  check((await read(page)).bodies === 10, "nor did it");
  check(page.errors.length === 0, `no error in the page ${page.errors.join("; ")}`);
  await page.close();
  await stop(server);
  await rm(folder, { recursive: true, force: true });
}

/** An address that nothing listens at. */
function freeAddress() {
  const server = createServer();
  return new Promise((resolve) => {
    server.listen(0, "127.0.0.1", () => {
      const { port } = server.address();
      server.close(() => resolve(`127.0.0.1:${port}`));
    });
  });
}

/** An etcd of its own; undefined where it is not installed. Its gateway needs a port that is named. */
async function startEtcd(folder) {
  const endpoint = `http://${await freeAddress()}`;
  const listens = ["--listen-client-urls", endpoint, "--listen-peer-urls", "http://127.0.0.1:0"];
  const etcd = spawn("etcd", ["--data-dir", folder, "--advertise-client-urls", endpoint, ...listens]);
  return new Promise((resolve) => {
    etcd.once("error", () => resolve(undefined));
    createInterface({ input: etcd.stderr }).on("line", (line) => {
      if (line.includes("ready to serve client requests")) resolve({ endpoint, server: etcd });
    });
  });
}

/** Moves a scene by an order. On a busy machine one may end before the other server has come near. */
function moveScene(order, tries = 4) {
  try {
    execFileSync(binary, order);
  } catch (cause) {
    if (tries === 1) throw cause;
    moveScene(order, tries - 1);
  }
}

/** A scene that moves from server to server: its page and a client of the package go with it. */
async function aSceneThatMovesIsFollowed(browser) {
  const folder = await mkdtemp(join(tmpdir(), "rhumb-page-"));
  const etcd = await startEtcd(join(folder, "etcd"));
  if (etcd === undefined) return console.log("left out: etcd is not installed");
  servers.add(etcd);
  const listens = ["--listen", "127.0.0.1:0", "--view", "127.0.0.1:0", "--log", "off"];
  const shared = ["--open", "--data", join(folder, "data"), "--directory", etcd.endpoint, ...listens];
  const two = [await startServer(binary, shared), await startServer(binary, shared)];
  for (const server of two) servers.add(server);
  const factsOf = async ({ url }) => (await fetch(new URL("connect.json", url))).json();
  const [one, other] = [await factsOf(two[0]), await factsOf(two[1])];
  check(`${one.certificateHashes}` === `${other.certificateHashes}`, "servers of one directory show browsers one certificate");
  const page = await openPage(browser, two[0].url);
  await page.evaluate(async ({ url, certificateHashes }) => {
    const { connect } = await import("/client/rhumb.js");
    const join = async () => (await connect(url, { certificateHashes })).join("pit", { mode: { create: { stepping: "freeRunning" } } });
    // A server that has just started may have no lease yet.
    const joined = () => join().catch((cause) => (cause.closeCode === 7 ? joined() : Promise.reject(cause)));
    const scene = await joined();
    scene.addBody({ kind: "fixed", shape: { kind: "cuboid", halfExtents: [9, 0.5, 9] }, position: [0, -0.5, 0] });
    const ball = (at) => ({ kind: "dynamic", shape: { kind: "ball", radius: 0.5 }, position: [at - 5, 20 + at, 0] });
    scene.addBodies(Array.from({ length: 10 }, (_, at) => ball(at)));
    globalThis.owner = scene;
    globalThis.resumed = 0;
    globalThis.states = new Set();
    setInterval(() => {
      for (let event = owner.pollEvent(); event !== undefined; event = owner.pollEvent()) resumed += event.kind === "resumed";
      states.add(rhumbDiagnostics.state);
    }, 10);
  }, one);
  await until(page, "d.state === 'open' && d.bodies === 10 && d.comparison.allBodyTicks > 200");
  await page.evaluate(() => states.clear());
  for (const [moves, to] of [other, one, other].entries()) {
    const { allBodyTicks } = await read(page);
    moveScene(["move", "pit", "--to", new URL(to.url).host, "--directory", etcd.endpoint]);
    await until(page, `resumed === ${moves + 1} && owner.state === "open"`);
    await page.evaluate((at) => {
      owner.addBody({ kind: "dynamic", shape: { kind: "ball", radius: 0.5 }, position: [at, 20, 3] });
    }, moves);
    await until(page, `d.bodies === ${11 + moves} && d.comparison.allBodyTicks > ${allBodyTicks + 200}`);
  }
  const { beyondBound } = await read(page);
  check(beyondBound === 0, "a page follows a scene that moves, within its stated bounds");
  const states = await page.evaluate(() => [...states].join(", "));
  check(states === "open", `and its picture continues: ${states}`);
  await aSceneElsewhereIsJoined(browser, { url: two[0].url, facts: one });
  check(page.errors.length === 0, `no error in the page ${page.errors.join("; ")}`);
  await page.close();
  for (const server of [...two, etcd]) await stop(server);
  await rm(folder, { recursive: true, force: true });
}

/** A server that does not have a scene sends its page, and a client of the package, to the one that has it. */
async function aSceneElsewhereIsJoined(browser, { url, facts }) {
  const page = await openPage(browser, `${url}?scene=pit`);
  await until(page, "d.state === 'open' && d.bodies === 13");
  const bodies = await page.evaluate(async ({ url, certificateHashes }) => {
    const { connect } = await import("/client/rhumb.js");
    const scene = await (await connect(url, { certificateHashes })).join("pit");
    scene.poll();
    return scene.view.count;
  }, facts);
  check(bodies === 14, "a page of another server than the scene's is sent on, and so is a client");
  await page.close();
}

async function thePlayerIsDriven(browser) {
  const demo = await start({ scene: "cubes" });
  const page = await openPage(browser, demo.url);
  await until(page, "d.state === 'open' && d.shown !== undefined && d.bodies > 100");
  const { player } = (await (await fetch(new URL("connect.json", demo.url))).json()).scenes.find(({ name }) => name === "cubes");
  const from = await bodyAt(page, player);
  await page.keyboard.down("KeyW");
  let way = 0;
  for (let tries = 0; tries < 400 && way < 2; tries++) {
    await page.waitForTimeout(50);
    const { position } = await bodyAt(page, player);
    way = Math.hypot(position[0] - from.position[0], position[2] - from.position[2]);
  }
  await page.keyboard.up("KeyW");
  check(way >= 2, "a key drives the player of the cubes");
  await page.close();
  await stop(demo);
}

/** Every scene of the demo is drawn, in light and dark, on a phone. */
async function everySceneIsReadable(browser, { url }) {
  const page = await openPage(browser, url, { width: 390, height: 800, colorScheme: "dark" });
  await until(page, "d.state === 'open'");
  const ground = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const dark = await ground();
  await page.evaluate(() => document.getElementById("theme").click());
  const light = await ground();
  const brightness = (colour) => colour.match(/\d+/g).reduce((sum, part) => sum + Number(part), 0);
  check(brightness(dark) < 200 && brightness(light) > 600, `the page is dark (${dark}) or light (${light})`);
  const scenes = await page.evaluate(() => [...document.getElementById("scene").options].map(({ value }) => value));
  check(scenes.length === 5, `the page offers ${scenes.join(", ")}`);
  for (const scene of scenes) {
    await choose(page, "scene", scene);
    await until(page, () => document.getElementById("status").textContent.startsWith("Following"));
    const { allBodyTicks } = await read(page);
    await until(page, `d.state === 'open' && d.bodies > 0 && d.comparison.allBodyTicks > ${allBodyTicks + 500}`);
    const width = await page.evaluate(() => document.documentElement.scrollWidth);
    if (width !== 390) throw new Error(`${scene} is ${width} pixels wide on a phone`);
    const { beyondBound } = await read(page);
    check(beyondBound === 0, `${scene} is followed within its stated bounds`);
  }
  check(page.errors.length === 0, `no error in the page ${page.errors.join("; ")}`);
  await page.close();
}

async function aRestartedServerIsFoundAgain(page, demo) {
  await stop(demo);
  await until(page, "d.state === 'lost' && !document.getElementById('notice').hidden");
  const said = await notice(page);
  check(said.includes("tries to connect again"), `the page says: ${said}`);
  const again = await start({ view: demo.view });
  await until(page, "d.state === 'open' && document.getElementById('notice').hidden && d.bodies === 500");
  const { ticks } = await read(page);
  await until(page, `d.comparison.ticks > ${ticks + 3}`);
  check((await read(page)).beyondTolerance === 0, "it comes back by itself, and compares again");
  check(page.errors.length === 0, `no error in the page ${page.errors.join("; ")}`);
  await page.close();
  return again;
}

async function obstaclesAreExplained(browser, { url }) {
  const noTransport = (page) => page.addInitScript(() => delete globalThis.WebTransport);
  let page = await openPage(browser, url, { prepare: noTransport });
  await until(page, "d.state === 'impossible'");
  check((await text(page, "notice")).includes("Open this page in"), "a browser without WebTransport gets a sentence");
  await page.close();

  const wrongHash = (page) =>
    page.route("**/connect.json", async (route) => {
      const response = await route.fetch();
      const facts = await response.json();
      facts.certificateHashes = ["00".repeat(32)];
      await route.fulfill({ response, json: facts });
    });
  page = await openPage(browser, url, { prepare: wrongHash });
  await until(page, "d.state === 'lost'");
  const said = await notice(page);
  check(/certificate/.test(said), `another certificate gets a sentence: ${said}`);
  await page.close();

  const foreign = await fetch(new URL("connect.json", url), { headers: { origin: "https://example.org" } });
  const reason = await foreign.text();
  check(
    foreign.status === 403 && reason.includes("example.org"),
    `a page of another origin is refused: ${reason.trim()}`,
  );
}

/** Pauses the page in the first frame in which an expression about its counts `d` holds: a picture takes longer than a frame. */
const pauseWhen = (page, condition) =>
  page.evaluate(`new Promise((resolve) => {
    const look = () => {
      const d = rhumbDiagnostics;
      if (!(d.state === "open" && d.bodies > 0 && (${condition}))) return requestAnimationFrame(look);
      document.getElementById("live").click();
      requestAnimationFrame(() => requestAnimationFrame(resolve));
    };
    look();
  })`);

/** The pictures of the book: start, burst and rest, and the burst on a phone and in the dark. */
async function takePictures(browser) {
  // A ball of the upper layers is in the air.
  const fall = "d.moving === 500 && d.comparison.ticks > 0 && d.drawnPosition(d.shown.ids.length - 1)[1] > 9";
  const lowest = "Math.min(...Array.from({ length: 100 }, (_, at) => d.drawnPosition(d.shown.ids.length - 1 - at)[1]))";
  const burst = `d.moving > 400 && d.sums.besideWorst > 5 && d.sums.worst > 0.03 && ${lowest} < 2`;
  for (const [options, moments] of [
    [
      { width: 1180, height: 700, shadows: true },
      [["start", fall], ["burst", burst], ["rest", "d.moving < 3"]],
    ],
    [{ width: 390, height: 844, shadows: true }, [["phone", burst]]],
    [{ width: 1180, height: 700, colorScheme: "dark", shadows: true }, [["dark", burst]]],
  ]) {
    const demo = await start();
    const page = await openPage(browser, demo.url, options);
    for (const [name, condition] of moments) {
      await pauseWhen(page, condition);
      const path = `${pictures}/view-${name}.jpg`;
      await page.screenshot({ path, type: "jpeg", quality: 70 });
      console.log(`wrote ${path}`);
      await page.evaluate(() => document.getElementById("live").click());
    }
    await page.close();
    await stop(demo);
  }
}

/** A choice that was made before the page's scripts run holds. */
async function choicesWaitForTheScripts(browser, { url }) {
  const chosen = (page) =>
    page.addInitScript(() => {
      // Between the end of the text and the first module.
      const choose = () => {
        for (const id of ["truth", "lines", "flashes"]) document.getElementById(id).click();
        document.getElementById("colour").value = "rest";
      };
      document.addEventListener("readystatechange", choose, { once: true });
    });
  const page = await openPage(browser, url, { prepare: chosen });
  // Bodies of which the error is unknown are blue; those that move or rest are not.
  const isOfRest = "d.drawnColours().every(([, , blue]) => blue < 0.3)";
  await until(page, `d.state === 'open' && d.bodies > 0 && d.time > 60 && ${isOfRest}`);
  const { allBodyTicks } = await read(page);
  const rings = await page.evaluate(() => rhumbDiagnostics.rings());
  check(allBodyTicks === 0 && rings === 0, "boxes that were cleared before the scripts ran stay clear");
  await page.close();
}

/** Every promise in one browser. */
async function run(name, browser) {
  const demo = await start();
  const page = await ballsFallWithinTheTolerance(browser, demo);
  await aBadLinkStaysWithinTheStatedBounds(page);
  await handsWork(page);
  await linesLeadToTheTruth(page);
  await coloursFollowTheKeys(page);
  await keysWorkAfterAClick(page);
  await theLastMinuteIsKept(page);
  const again = await aRestartedServerIsFoundAgain(page, demo);
  // The driver of Firefox answers no requests in the place of a server.
  if (name === "Chromium") {
    await choicesWaitForTheScripts(browser, again);
    await obstaclesAreExplained(browser, again);
    await theAddressIsShared(browser, again);
    await everySceneIsReadable(browser, again);
    await aTokenOfTheServerObserves(browser);
  }
  await aSceneThatMovesIsFollowed(browser);
  await stop(again);
  await thePlayerIsDriven(browser);
}

for (const [name, open] of [
  ["Chromium", openChromium],
  ["Firefox", openFirefox],
]) {
  if (process.env.RHUMB_BROWSERS && !process.env.RHUMB_BROWSERS.split(" ").includes(name)) continue;
  let browser;
  try {
    browser = await open();
    console.log(`${name}: ${await browser.version()}`);
    if (pictures === undefined) await run(name, browser);
    else if (name === "Chromium") await takePictures(browser);
  } catch (cause) {
    console.log(cause instanceof Missing ? `${name} skipped: ${cause.message}` : `FAILED in ${name}: ${cause.stack}`);
    if (!(cause instanceof Missing)) process.exitCode = 1;
  } finally {
    await browser?.close();
    for (const demo of servers) await stop(demo);
  }
}
