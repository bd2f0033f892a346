// Errors of this package: a code for programs, a sentence for people.

/** The error of a wrong argument, which `what` names. */
export const wrong = (what, value, needed) => {
  const found = typeof value === "string" ? JSON.stringify(value) : String(value);
  return new RhumbError({ code: "argument", message: `${what} is ${found}, and must be ${needed}` });
};

/** Refuses an option that nothing reads. */
export function checkNames(what, options, known) {
  if (options === null || typeof options !== "object") throw wrong(what, options, "an object");
  const unknown = Object.keys(options).find((name) => !known.includes(name));
  if (unknown === undefined) return;
  throw new RhumbError({ code: "argument", message: `${what}.${unknown} is not known: the fields here are ${known.join(", ")}` });
}

export class RhumbError extends Error {
  constructor({ code, message, denial, closeCode, refusals, refusalsLeftOut }, options) {
    super(message, options);
    this.name = "RhumbError";
    this.code = code;
    if (denial != null) this.denial = denial;
    if (closeCode != null) this.closeCode = closeCode;
    if (refusals != null) this.refusals = refusals;
    if (refusalsLeftOut != null) this.refusalsLeftOut = refusalsLeftOut;
  }
}
