// Measures the page in Chromium: frame times of many bodies, and memory over minutes. Prints figures, asserts none.
//
// Usage: node measure.mjs RHUMB_SERVER frames [truth] [BODIES...] | undrawn [truth] [BODIES...] | memory MINUTES
// `undrawn` is `frames` with a graphics card that takes no time: the page does all its work, and nothing is drawn. `truth`
// has the page compare with the truth, which is a stream of every state.

import { openChromium } from "./browsers.mjs";
import { kill, openPage, read, startDemo, until } from "./support.mjs";

const [binary, what, ...options] = process.argv.slice(2);
const hasTruth = options[0] === "truth";
const numbers = hasTruth ? options.slice(1) : options;
if (binary === undefined || !["frames", "undrawn", "memory"].includes(what)) {
  console.error("usage: node measure.mjs RHUMB_SERVER frames [truth] [BODIES...] | undrawn [truth] [BODIES...] | memory MINUTES");
  process.exit(2);
}
const browser = await openChromium();
const demos = [];

async function start(more) {
  const demo = await startDemo(binary, { more });
  demos.push(demo);
  return demo;
}

const at = (times, share) =>
  [...times].sort((a, b) => a - b)[Math.min(times.length - 1, Math.floor(share * times.length))].toFixed(1);

/** Stops the page from drawing. */
const undrawn = (page) =>
  page.addInitScript(() => {
    for (const name of ["clear", "drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"])
      WebGL2RenderingContext.prototype[name] = () => {};
  });

/** Frame times while balls fall and burst apart. */
async function frames(bodies, prepare) {
  const demo = await start(["--bodies", String(bodies)]);
  const page = await openPage(browser, demo.url, { width: 640, height: 400, shadows: true, prepare });
  await until(page, "d.state === 'open'");
  if (!hasTruth) await page.evaluate(() => document.getElementById("truth").click());
  await until(page, `d.bodies >= ${bodies} && d.moving > ${bodies / 2}`);
  await page.evaluate(() => {
    rhumbDiagnostics.frameTimes.length = rhumbDiagnostics.workTimes.length = 0;
  });
  // Drawing by the processor takes seconds a frame: 20 frames at least, 300 if 20 seconds are enough for them.
  const end = performance.now() + 20_000;
  await until(page, "d.workTimes.length >= 20");
  while ((await read(page)).workTimes.length < 300 && performance.now() < end) await page.waitForTimeout(500);
  const { frameTimes, workTimes, moving, ticks, allBodyTicks } = await read(page);
  const compared = hasTruth ? `; ${ticks} complete ticks and ${allBodyTicks} body-ticks were compared` : "";
  console.log(
    `${bodies} bodies, ${moving} of them moving: frame p50 ${at(frameTimes, 0.5)} ms, p99 ${at(frameTimes, 0.99)} ms; ` +
      `JavaScript p50 ${at(workTimes, 0.5)} ms, p99 ${at(workTimes, 0.99)} ms${compared}`,
  );
  await page.close();
}

/** Bytes of the memory of WebAssembly modules. */
async function moduleBytes(session) {
  const { result: prototype } = await session.send("Runtime.evaluate", { expression: "WebAssembly.Memory.prototype" });
  const { objects } = await session.send("Runtime.queryObjects", { prototypeObjectId: prototype.objectId });
  const sum = "function () { return this.reduce((sum, memory) => sum + memory.buffer.byteLength, 0); }";
  const options = { objectId: objects.objectId, functionDeclaration: sum, returnByValue: true };
  const { result } = await session.send("Runtime.callFunctionOn", options);
  for (const { objectId } of [prototype, objects]) await session.send("Runtime.releaseObject", { objectId });
  return result.value;
}

/** Memory of the page, minute by minute, after a collection. */
async function memory(minutes) {
  const demo = await start([]);
  const page = await openPage(browser, demo.url, { shadows: true });
  await until(page, "d.state === 'open'");
  const session = await page.context().newCDPSession(page);
  for (let minute = 0; minute <= minutes; minute++) {
    await session.send("HeapProfiler.collectGarbage");
    const { usedSize, backingStorageSize } = await session.send("Runtime.getHeapUsage");
    const module = await moduleBytes(session);
    const { ticks, beyondTolerance, bodyTicks } = await read(page);
    console.log(
      `${minute} min: heap ${(usedSize / 1e6).toFixed(1)} MB, arrays ${(backingStorageSize / 1e6).toFixed(1)} MB, ` +
        `WebAssembly ${(module / 1e6).toFixed(1)} MB; ` +
        `${ticks} ticks compared, ${beyondTolerance} of ${bodyTicks} body-ticks beyond the tolerance`,
    );
    if (minute < minutes) await page.waitForTimeout(60_000);
  }
  await page.close();
}

/** The name of what draws. */
async function drawer() {
  const page = await browser.newPage();
  const name = await page.evaluate(() => {
    const context = document.createElement("canvas").getContext("webgl2");
    const named = context?.getExtension("WEBGL_debug_renderer_info");
    return context?.getParameter(named?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER);
  });
  await page.close();
  return name ?? "nothing: no WebGL 2";
}

try {
  console.log(`${browser.version()}, drawn by ${await drawer()}`);
  if (what === "memory") await memory(Number(numbers[0] ?? 10));
  else {
    const prepare = what === "undrawn" ? undrawn : undefined;
    for (const bodies of numbers.length > 0 ? numbers.map(Number) : [2000, 10000]) await frames(bodies, prepare);
  }
} finally {
  await browser.close();
  for (const demo of demos) await kill(demo);
}
