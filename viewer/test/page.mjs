// The page in a real browser, over the real protocol, against `rhumb-server demo`.
//
// Usage: node page.mjs RHUMB_SERVER [--pictures FOLDER]. Prints why and passes where no browser is installed. It asserts no
// time: what a slow machine does not draw is not compared.

import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { check, choose, kill, openBrowser, openPage, read, startDemo, until } from "./support.mjs";

const [binary, option, pictures] = process.argv.slice(2);
if (binary === undefined || (option !== undefined && option !== "--pictures")) {
  console.error("usage: node page.mjs RHUMB_SERVER [--pictures FOLDER]");
  process.exit(2);
}
const traces = fileURLToPath(new URL("../../tests/data/traces/", import.meta.url));
const browser = await openBrowser();
const servers = new Set();
const start = async (options) => {
  const demo = await startDemo(binary, options);
  servers.add(demo);
  return demo;
};

/** Moves a slider, as a hand would. */
const slide = (page, id, value) =>
  page.evaluate(
    ([id, value]) => {
      const input = document.getElementById(id);
      input.value = value;
      input.dispatchEvent(new Event("input", { bubbles: true }));
    },
    [id, value],
  );

const text = (page, id) => page.evaluate((id) => document.getElementById(id).textContent, id);

const notice = (page) => page.evaluate(() => document.querySelector("#notice p").textContent);

async function ballsFallWithinTheTolerance({ url }) {
  const page = await openPage(browser, url);
  await until(page, "d.state === 'open' && d.bodies === 500");
  await choose(page, "shown", "complete");
  // From the fall over the burst until most of them rest.
  await until(page, "d.time > 420 && d.comparison.ticks >= 25");
  const counts = await read(page);
  check(counts.beyondTolerance === 0, `of ${counts.bodyTicks} displayed body-ticks none is beyond the tolerance`);
  check(counts.bodyTicks === 500 * counts.ticks, `all bodies of ${counts.ticks} ticks were compared`);
  check(
    counts.beyondBound === 0 && counts.boundedBodyTicks > 0,
    `nor one of ${counts.boundedBodyTicks} beyond its stated bound`,
  );
  check(
    counts.greatestShare > 0.2 && counts.greatestShare <= 1.002,
    `the greatest error is ${counts.greatestShare.toFixed(3)} tolerances`,
  );
  check(counts.moving < 500, "balls come to rest");
  return page;
}

async function aBadLinkStaysWithinTheStatedBounds(page) {
  await slide(page, "link-delay", 100);
  await slide(page, "link-loss", 5);
  await until(page, async () => {
    const link = await (await fetch("link")).text();
    return link === "delay=100ms,loss=5%";
  });
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
  const { time } = await read(page);
  await until(page, `d.time > ${time + 60}`);
  check(
    (await read(page)).beyondBound === 0,
    "the present moment is predicted, and no bound is stated that does not hold",
  );
  await choose(page, "shown", "complete");
  await page.evaluate(() => document.getElementById("link-clear").click());
}

async function handsAndTimeWork(page) {
  await until(page, "d.state === 'open'");
  const { bodies } = await read(page);
  await page.keyboard.press("KeyN");
  await until(page, `d.bodies === ${bodies + 1}`);
  check(true, "a key drops a box");
  await page.keyboard.press("Delete");
  await until(page, `d.bodies === ${bodies}`);
  check(true, "a key removes it");
  await page.evaluate(() => document.querySelector("[data-tolerance='0.02']").click());
  await until(page, () => document.getElementById("tolerance-shown").textContent === "20.0 mm");
  const { allBodyTicks } = await read(page);
  await until(page, `d.comparison.allBodyTicks > ${allBodyTicks + 1000}`);
  const counts = await read(page);
  check(counts.beyondTolerance === 0, "another tolerance holds as well");
  await page.keyboard.press("KeyP");
  check((await text(page, "moment")).endsWith("ago"), "the last minute can be looked at");
  await page.keyboard.press("ArrowLeft");
  await page.keyboard.press("KeyP");
  check((await text(page, "moment")) === "live", "and left again");
  const { width, height } = await page.evaluate(() => document.getElementById("view").getBoundingClientRect().toJSON());
  await page.mouse.click(
    width / 2,
    height * 0.6 + (await page.evaluate(() => document.getElementById("view").getBoundingClientRect().top)),
  );
  await until(page, () => document.getElementById("body-facts").textContent.includes("predictor"));
  check(true, "a click shows a body's track");
}

async function aRestartedServerIsFoundAgain(page, demo) {
  await kill(demo);
  servers.delete(demo);
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

async function obstaclesAreExplained({ url }) {
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

async function recordingsPlay({ url }) {
  const page = await openPage(browser, url);
  await until(page, "d.state === 'open'");
  await page.setInputFiles("#recording", `${traces}free_fall.mcap`);
  await until(page, () => document.getElementById("moment").textContent.includes(" of "));
  const said = await text(page, "status");
  check(/free_fall.mcap: \d+ (body|bodies), /.test(said), `a trace plays: ${said}`);
  await slide(page, "scrubber", 10);
  await page.setInputFiles("#recording", { name: "boxes.rhtrace", mimeType: "", buffer: boxes() });
  await until(page, () => document.getElementById("status").textContent.includes("2 boxes, 60 frames"));
  check(true, "an .rhtrace plays");
  await page.setInputFiles("#recording", {
    name: "cut.mcap",
    mimeType: "",
    buffer: readFileSync(`${traces}free_fall.mcap`).subarray(0, 900),
  });
  await until(page, () => document.getElementById("status").textContent.includes("cannot be played"));
  check(true, `a damaged one is refused: ${await text(page, "status")}`);
  await page.keyboard.press("Escape");
  await until(page, () => document.getElementById("moment").textContent === "live");
  check(page.errors.length === 0, `no error in the page ${page.errors.join("; ")}`);
  await page.close();
}

/** An .rhtrace of two boxes, one of which rises. */
function boxes() {
  const bodies = 2;
  const frames = 60;
  const bytes = Buffer.alloc(8 + 8 + 4 + 12 + 16 * bodies + 2 * frames + 55 * (frames + 1));
  let at = bytes.write("RHTRACE1", "latin1");
  const u16 = (value) => (at = bytes.writeUInt16LE(value, at));
  const f32 = (value) => (at = bytes.writeFloatLE(value, at));
  at = bytes.writeUInt32LE(frames, bytes.writeUInt32LE(bodies, at));
  for (const value of [1 / 60, 0, -9.8, 0]) f32(value);
  for (let body = 0; body < bodies; body++) for (const value of [0.5, 0.5, 0.5, Math.hypot(0.5, 0.5, 0.5)]) f32(value);
  for (let frame = 0; frame < frames; frame++) {
    const moved = frame === 0 ? [0, 1] : [1];
    u16(moved.length);
    for (const body of moved) {
      u16(body);
      for (const value of [2 * body, 0.5 + 0.1 * frame * body, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]) f32(value);
      at = bytes.writeUInt8(1, at);
    }
  }
  return bytes;
}

async function takePictures() {
  const demo = await start();
  const page = await openPage(browser, demo.url, { width: 1180, height: 700 });
  await choose(page, "shown", "complete");
  await page.evaluate(() => document.getElementById("flashes").click());
  for (const [name, condition] of [
    ["start", "d.bodies === 500 && d.comparison.ticks > 0"],
    ["burst", "d.time > 110 && d.moving > 300 && d.comparison.worst > 0.03 && d.time - d.comparison.tick < 9"],
    ["rest", "d.time > 500 && d.moving < 3"],
  ]) {
    await until(page, condition);
    const path = `${pictures}/view-${name}.jpg`;
    await page.screenshot({ path, type: "jpeg", quality: 70 });
    console.log(`wrote ${path}`);
  }
  await page.close();
}

try {
  if (pictures !== undefined) {
    await takePictures();
  } else {
    const demo = await start();
    const page = await ballsFallWithinTheTolerance(demo);
    await aBadLinkStaysWithinTheStatedBounds(page);
    await handsAndTimeWork(page);
    const again = await aRestartedServerIsFoundAgain(page, demo);
    await obstaclesAreExplained(again);
    await recordingsPlay(again);
  }
} finally {
  await browser.close();
  for (const demo of servers) await kill(demo);
}
