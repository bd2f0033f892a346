// Numbers and sentences for people.

export function number(value, digits) {
  return value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

export function metres(length) {
  if (length >= 1) return `${number(length, 2)} m`;
  if (length >= 0.1) return `${number(100 * length, 1)} cm`;
  return `${number(1000 * length, 1)} mm`;
}

/** A length in as few digits as it was chosen with: 50 mm, 0.2 m. */
export function shortMetres(length) {
  const [value, unit] = length >= 1 ? [length, "m"] : length >= 0.1 ? [100 * length, "cm"] : [1000 * length, "mm"];
  return `${Number(value.toPrecision(3))} ${unit}`;
}

/** Bytes of a second. */
export function byteRate(bytes) {
  if (bytes < 1e3) return `${number(bytes, 0)} B/s`;
  return bytes < 1e6 ? `${number(bytes / 1e3, 1)} kB/s` : `${number(bytes / 1e6, 2)} MB/s`;
}

/** A text with a capital at its beginning, and a full stop. */
export function sentence(text) {
  const whole = text.trim();
  return whole.charAt(0).toUpperCase() + whole.slice(1) + (/[.!?]$/.test(whole) ? "" : ".");
}
