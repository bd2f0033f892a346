// The fields of the page's address: scene, tolerance and link, or the load and run of a recording. It can be shared.

/** Of each condition of the link: its unit, and its greatest value, as the sliders have it. */
const LINK = { delay: ["ms", 500], jitter: ["ms", 100], loss: ["%", 30], rate: ["kbit", 10_000] };
const TOLERANCE_MIN = 0.001;
const TOLERANCE_MAX = 1;
const NAMES = ["scene", "tolerance", "link", "load", "run"];

/** The values of an address; `wrong`: a sentence for each that cannot be used, and that is left out. */
export function readAddress(search) {
  const given = new URLSearchParams(search);
  const wrong = [];
  const found = { wrong };
  for (const name of new Set(given.keys())) {
    if (!NAMES.includes(name)) wrong.push(`The address has "${name}", which is not known: it takes ${NAMES.join(", ")}`);
    else if (given.getAll(name).length > 1) wrong.push(`The address has more than one ${name}: the first counts`);
  }
  for (const name of ["scene", "load", "run"]) if (given.get(name)) found[name] = given.get(name);
  const tolerance = given.get("tolerance");
  if (tolerance !== null) {
    const length = /^\d*\.?\d+$/.test(tolerance) ? Number(tolerance) : NaN;
    if (length >= TOLERANCE_MIN && length <= TOLERANCE_MAX) found.tolerance = length;
    else wrong.push(`The address asks for the tolerance "${tolerance}": it is metres from ${TOLERANCE_MIN} to ${TOLERANCE_MAX}, as 0.05`);
  }
  const link = given.get("link");
  if (link !== null) {
    const condition = readLink(link);
    if (condition !== undefined) found.link = condition;
    else
      wrong.push(
        `The address asks for the link "${link}": it is a list as delay=100ms,jitter=20ms,loss=5%,rate=500kbit, with a delay up to ` +
          "500 ms, a jitter up to 100 ms, a loss up to 30 % and a rate up to 10000 kbit",
      );
  }
  return found;
}

/** The values of a link's condition; undefined if it is none. An empty text is a perfect link. */
function readLink(text) {
  const link = { delay: 0, jitter: 0, loss: 0, rate: 0 };
  const stated = new Set();
  for (const part of text.split(",").filter((part) => part !== "")) {
    const [, name, value, unit] = /^([a-z]+)=(\d*\.?\d+)([a-z%]*)$/.exec(part) ?? [];
    const [expected, greatest] = Object.hasOwn(LINK, name ?? "") ? LINK[name] : [];
    if (expected === undefined || unit !== expected || Number(value) > greatest || stated.has(name)) return undefined;
    stated.add(name);
    link[name] = Number(value);
  }
  return link;
}

/** A link's condition in words of the server; empty for a perfect one. */
export function linkText(link) {
  const given = Object.entries(LINK).filter(([name]) => link[name] > 0);
  return given.map(([name, [unit]]) => `${name}=${link[name]}${unit}`).join(",");
}

/** Puts values into the address, without a new entry of the browser's history; undefined removes one. */
export function writeAddress(values) {
  const given = new URLSearchParams(location.search);
  for (const [name, value] of Object.entries(values)) {
    if (value === undefined || value === "") given.delete(name);
    else given.set(name, value);
  }
  // Signs that need no escape in a query stay readable.
  const plain = (text) => encodeURIComponent(text).replaceAll("%3D", "=").replaceAll("%2C", ",").replaceAll("%2F", "/");
  const order = [...given].sort(([one], [other]) => NAMES.indexOf(one) - NAMES.indexOf(other));
  const query = order.map(([name, value]) => `${plain(name)}=${plain(value)}`).join("&");
  history.replaceState(null, "", `${location.pathname}${query && `?${query}`}${location.hash}`);
}
