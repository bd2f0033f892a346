// A server and its page, for the page's tests.

import { spawn } from "node:child_process";
import { createInterface } from "node:readline";

/** A wait that is longer ends a test, milliseconds. */
export const LIMIT = 120_000;

/** Starts `rhumb-server demo`; resolves with its process and the address of its page. */
export function startDemo(binary, { scene = "ball-pit", view = "127.0.0.1:0", more = [] } = {}) {
  return startServer(binary, ["demo", scene, "--view", view, "--no-browser", ...more]);
}

/** Starts a server with a page; resolves as `startDemo` does. */
export function startServer(binary, options) {
  const server = spawn(binary, options, { stdio: ["ignore", "pipe", "inherit"] });
  return new Promise((resolve, reject) => {
    server.once("exit", (code) => reject(new Error(`the server ended with code ${code}`)));
    createInterface({ input: server.stdout }).on("line", (line) => {
      const url = line.match(/^page at (http:.*)$/)?.[1];
      if (url !== undefined) resolve({ server, url, view: new URL(url).host });
    });
  });
}

/** Ends a server at once, as a fault would. */
export function kill({ server }) {
  server.removeAllListeners("exit");
  return new Promise((resolve) => {
    server.once("exit", resolve);
    server.kill("SIGKILL");
  });
}

/**
 * Opens the page; its errors are collected in `errors`. `prepare` runs before it is loaded. Without `shadows`, a processor draws
 * twice as fast.
 */
export async function openPage(browser, url, { width = 480, height = 360, colorScheme = "light", shadows = false, prepare } = {}) {
  const page = await browser.newPage({ viewport: { width, height }, colorScheme });
  page.setDefaultTimeout(LIMIT);
  page.errors = [];
  page.on("pageerror", (error) => page.errors.push(error.stack ?? error.message));
  page.on("console", (message) => {
    // A file that cannot be loaded while the server is away is no error of the page.
    if (message.type() === "error" && !/Failed to load resource|ERR_|net::|WebTransport/.test(message.text()))
      page.errors.push(message.text());
  });
  await prepare?.(page);
  await page.goto(url);
  if (!shadows) await page.evaluate(() => document.getElementById("shadows").click());
  return page;
}

/** The page's counts. */
export const read = (page) =>
  page.evaluate(() => {
    const { comparison, shown, ...all } = rhumbDiagnostics;
    const rest = Object.fromEntries(Object.entries(all).filter(([, value]) => typeof value !== "function"));
    const counts = Object.entries(comparison ?? {}).filter(([, value]) => typeof value === "number");
    return {
      ...rest,
      ...Object.fromEntries(counts),
      frameTimes: [...rest.frameTimes],
      workTimes: [...rest.workTimes],
    };
  });

/**
 * Waits until a function of the page, or an expression about its counts `d`, holds. The page's policy forbids it to make
 * functions of texts, so it is asked from here.
 */
export async function until(page, condition) {
  const expression =
    typeof condition === "string"
      ? `(() => { const d = globalThis.rhumbDiagnostics; return d !== undefined && (${condition}); })()`
      : condition;
  const end = performance.now() + LIMIT;
  while (!(await page.evaluate(expression))) {
    if (performance.now() > end) throw new Error(`it did not come: ${condition}`);
    await page.waitForTimeout(50);
  }
}

/** The page's text in an element. */
export const text = (page, id) => page.evaluate((id) => document.getElementById(id).textContent, id);

/** Moves a slider, as a hand would. */
export const slide = (page, id, value) =>
  page.evaluate(
    ([id, value]) => {
      const input = document.getElementById(id);
      input.value = value;
      input.dispatchEvent(new Event("input", { bubbles: true }));
    },
    [id, value],
  );

/** Chooses an option. */
export const choose = (page, id, value) =>
  page.evaluate(
    ([id, value]) => {
      const select = document.getElementById(id);
      select.value = value;
      select.dispatchEvent(new Event("change", { bubbles: true }));
    },
    [id, value],
  );

/** Fails unless a condition holds. */
export function check(condition, what) {
  if (!condition) throw new Error(`not so: ${what}`);
  console.log(`ok: ${what}`);
}
