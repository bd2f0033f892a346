// A page in a browser: one trial of a server, as `run` asks for it; prints what it saw as JSON.
//
// Usage: node client.mjs TRIAL ADDRESS HASH MESSAGES-AS-JSON BROWSER, which is `chromium` or `firefox`. Needs playwright-core
// or puppeteer-core in node_modules of RHUMB_NODE_MODULES.

import { createServer } from "node:http";
import { createRequire } from "node:module";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [trial, address, hash, messages, name] = process.argv.slice(2);

async function launch() {
  const packages = createRequire(join(process.env.RHUMB_NODE_MODULES, "package.json"));
  const driver = async (of) => (await import(pathToFileURL(packages.resolve(of)))).default;
  if (name === "chromium") {
    const { chromium } = await driver("playwright-core");
    return chromium.launch({ executablePath: process.env.RHUMB_CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
  }
  const puppeteer = await driver("puppeteer-core");
  const executablePath = process.env.RHUMB_FIREFOX ?? "/usr/bin/firefox-esr";
  return puppeteer.launch({ browser: "firefox", executablePath, headless: true });
}

/** In the page. */
async function attempt(trial, address, hash, sent) {
  const saw = {};
  const bytes = (text) => Uint8Array.from(text.match(/../g), (digits) => parseInt(digits, 16));
  const url = `https://${address}${trial === "path" ? "/rhumb/2" : "/rhumb/1"}`;
  const transport = new WebTransport(url, {
    serverCertificateHashes: [{ algorithm: "sha-256", value: bytes(hash) }],
    requireUnreliable: true,
    protocols: ["rhumb/1"],
  });
  const closed = transport.closed.then(
    ({ closeCode }) => closeCode,
    (error) => error.message,
  );
  try {
    await transport.ready;
  } catch (error) {
    saw.error = `${error.name}: ${error.message}`;
    return saw;
  }
  saw.status = 200;
  saw.protocol = transport.protocol ?? null;
  const stream = await transport.createBidirectionalStream();
  const writer = stream.writable.getWriter();
  const reader = stream.readable.getReader();
  let held = new Uint8Array();
  const byte = async () => {
    while (held.length === 0) held = (await reader.read()).value;
    const first = held[0];
    held = held.subarray(1);
    return first;
  };
  const say = async (message) => {
    await writer.write(bytes(message));
    return answer();
  };
  const answer = async () => {
    let [length, shift] = [0, 0];
    for (;;) {
      const one = await byte();
      length |= (one & 0x7f) << shift;
      shift += 7;
      if (one < 0x80) break;
    }
    const kind = await byte();
    for (let rest = 1; rest < length; rest += 1) await byte();
    // A type from 0x80 on is of a later version, and means nothing to this one.
    return kind < 0x80 ? kind : answer();
  };
  saw.welcome = await say(sent.Hello);
  if (trial === "session") {
    saw.created = await say(sent.Create);
    saw.joined = await say(sent.Join);
    saw.datagram = (await transport.datagrams.readable.getReader().read()).value.length;
    await writer.write(bytes(sent.Malformed));
    saw.closed = await closed;
  } else {
    transport.close({ closeCode: 9, reason: "done" });
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
  return saw;
}

/** A page; for a trial of origins its script runs in a frame without one. */
function page() {
  const script = `<script>(${attempt})(...${JSON.stringify([trial, address, hash, JSON.parse(messages)])})
    .catch((error) => ({ error: String(error) })).then((saw) => parent.postMessage(saw, "*"))</script>`;
  const frame = script.replaceAll("&", "&amp;").replaceAll('"', "&quot;");
  const sandbox = trial === "origin" ? 'sandbox="allow-scripts"' : "";
  return `<!doctype html><title>trial</title><script>
    window.saw = new Promise((resolve) => addEventListener("message", ({ data }) => resolve(data)));
    </script><iframe ${sandbox} srcdoc="${frame}"></iframe>`;
}

const files = createServer((_, response) => response.writeHead(200, { "content-type": "text/html" }).end(page()));
await new Promise((resolve) => files.listen(0, "127.0.0.1", resolve));
const browser = await launch();
try {
  const tab = await browser.newPage();
  await tab.goto(`http://127.0.0.1:${files.address().port}/`);
  const late = new Promise((resolve) => setTimeout(() => resolve({ error: "nothing after 15 s" }), 15_000));
  const saw = await Promise.race([tab.evaluate(() => window.saw), late]);
  console.log(JSON.stringify({ ...saw, browser: await browser.version() }));
} finally {
  await browser.close();
  files.close();
}
process.exit(0);
