// The browsers of the page's tests: Chromium and Firefox of the system, each behind the same few calls.
//
// Chromium is driven by playwright-core, Firefox by puppeteer-core. Both packages are found from here, or in the folder
// RHUMB_NODE_MODULES.

import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { createRequire } from "node:module";
import { fileURLToPath, pathToFileURL } from "node:url";

const root = fileURLToPath(new URL("..", import.meta.url));
/** Drawing without a graphics card; RHUMB_CHROMIUM_FLAGS, with spaces between them, replaces these. */
const SOFTWARE = "--no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader";
const CHROMIUM_FLAGS = (process.env.RHUMB_CHROMIUM_FLAGS ?? SOFTWARE).split(" ");
const FIREFOX_PREFS = { "webgl.force-enabled": true, "gfx.webrender.software": true };

/** A way to open a browser that is not here; its message says what is missing. */
export class Missing extends Error {}

export const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

/** Opens Chromium. Throws Missing if it is not installed, or its driver. */
export async function openChromium() {
  const executablePath = program("Chromium", [process.env.RHUMB_CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser"]);
  const { chromium } = await driver("playwright-core");
  return chromium.launch({ executablePath, args: CHROMIUM_FLAGS });
}

/** Opens Firefox. Throws Missing if it is not installed, or its driver, or a display: it draws in 3D in a window alone. */
export async function openFirefox() {
  const executablePath = program("Firefox", [process.env.RHUMB_FIREFOX, "/usr/bin/firefox-esr", "/usr/bin/firefox"]);
  const puppeteer = await driver("puppeteer-core");
  const display = process.env.DISPLAY ? { name: process.env.DISPLAY, close() {} } : await openDisplay();
  const env = { ...process.env, DISPLAY: display.name };
  try {
    const options = { browser: "firefox", executablePath, headless: false, extraPrefsFirefox: FIREFOX_PREFS, env };
    return new Firefox(await puppeteer.launch(options), display);
  } catch (cause) {
    display.close();
    throw cause;
  }
}

function program(name, places) {
  const place = places.find((path) => path && existsSync(path));
  if (place === undefined) throw new Missing(`${name} is not installed`);
  return place;
}

async function driver(name) {
  const paths = [process.env.RHUMB_NODE_MODULES, root].filter((path) => path);
  let place;
  try {
    place = createRequire(import.meta.url).resolve(name, { paths });
  } catch {
    throw new Missing(`${name} is not installed`);
  }
  const found = await import(pathToFileURL(place));
  return found.default;
}

/** A display in memory. */
function openDisplay() {
  const path = program("Xvfb", ["/usr/bin/Xvfb"]);
  // It writes the number of the display that it found free.
  const server = spawn(path, ["-displayfd", "3", "-screen", "0", "1280x800x24", "-nolisten", "tcp"], {
    stdio: ["ignore", "ignore", "ignore", "pipe"],
  });
  return new Promise((resolve, reject) => {
    server.once("exit", (code) => reject(new Error(`Xvfb ended with code ${code}`)));
    server.stdio[3].once("data", (number) => {
      server.removeAllListeners("exit");
      resolve({ name: `:${number.toString().trim()}`, close: () => server.kill() });
    });
  });
}

/** Firefox with the calls that these tests make of Chromium. */
class Firefox {
  #browser;
  #display;

  constructor(browser, display) {
    this.#browser = browser;
    this.#display = display;
  }

  version() {
    return this.#browser.version();
  }

  async newPage({ viewport }) {
    const page = await this.#browser.newPage();
    await page.setViewport(viewport);
    page.waitForTimeout = pause;
    return page;
  }

  async close() {
    await this.#browser.close();
    this.#display.close();
  }
}
