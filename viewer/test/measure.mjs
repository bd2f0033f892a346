// Measures the page in a browser: frame times of many bodies, and memory over minutes. Prints figures, asserts none.
//
// Usage: node measure.mjs RHUMB_SERVER frames [BODIES...] | memory MINUTES

import { choose, kill, openBrowser, openPage, read, startDemo, until } from "./support.mjs";

const [binary, what, ...numbers] = process.argv.slice(2);
if (binary === undefined || !["frames", "memory"].includes(what)) {
  console.error("usage: node measure.mjs RHUMB_SERVER frames [BODIES...] | memory MINUTES");
  process.exit(2);
}
const browser = await openBrowser();
const demos = [];

async function start(more) {
  const demo = await startDemo(binary, { more });
  demos.push(demo);
  return demo;
}

const at = (times, share) =>
  [...times].sort((a, b) => a - b)[Math.min(times.length - 1, Math.floor(share * times.length))].toFixed(1);

/** Frame times while balls fall and burst apart, without the truth, which is a stream of every state. */
async function frames(bodies) {
  const demo = await start(["--bodies", String(bodies)]);
  const page = await openPage(browser, demo.url, { width: 640, height: 400 });
  await page.evaluate(() => document.getElementById("truth").click());
  await until(page, `d.bodies >= ${bodies} && d.moving > ${bodies / 2}`);
  await page.evaluate(() => {
    rhumbDiagnostics.frameTimes.length = rhumbDiagnostics.workTimes.length = 0;
  });
  await until(page, "d.workTimes.length >= 20");
  const { frameTimes, workTimes, moving } = await read(page);
  console.log(
    `${bodies} bodies, ${moving} of them moving: frame p50 ${at(frameTimes, 0.5)} ms, p99 ${at(frameTimes, 0.99)} ms; ` +
      `JavaScript p50 ${at(workTimes, 0.5)} ms, p99 ${at(workTimes, 0.99)} ms`,
  );
  await page.close();
}

/** Memory of the page, minute by minute, after a collection. */
async function memory(minutes) {
  const demo = await start([]);
  const page = await openPage(browser, demo.url);
  await until(page, "d.state === 'open'");
  await choose(page, "shown", "complete");
  const session = await page.context().newCDPSession(page);
  for (let minute = 0; minute <= minutes; minute++) {
    await session.send("HeapProfiler.collectGarbage");
    const { usedSize, backingStorageSize } = await session.send("Runtime.getHeapUsage");
    const { ticks, beyondTolerance, bodyTicks } = await read(page);
    console.log(
      `${minute} min: heap ${(usedSize / 1e6).toFixed(1)} MB, arrays and WebAssembly ${(backingStorageSize / 1e6).toFixed(1)} MB; ` +
        `${ticks} ticks compared, ${beyondTolerance} of ${bodyTicks} body-ticks beyond the tolerance`,
    );
    if (minute < minutes) await page.waitForTimeout(60_000);
  }
  await page.close();
}

try {
  if (what === "memory") await memory(Number(numbers[0] ?? 10));
  else for (const bodies of numbers.length > 0 ? numbers.map(Number) : [2000, 10000]) await frames(bodies);
} finally {
  await browser.close();
  for (const demo of demos) await kill(demo);
}
