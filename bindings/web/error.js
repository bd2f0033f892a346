// Errors of this package: a code for programs, a sentence for people.

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
