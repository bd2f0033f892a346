// The condition of the page's link: delay, jitter, loss and rate, which the server's relay applies.

import { linkText } from "./address.js";

/** Rates in kbit/s, by the position of the slider; the first is no limit. */
const RATES = [0, 10000, 5000, 2000, 1000, 500, 300, 200, 128, 64, 48, 32, 16];
/** Milliseconds of calm before a change is sent. */
const CALM = 150;

export class Link {
  #inputs;
  #timer;
  /** Called with a sentence if the server refuses. */
  onerror = () => {};
  /** Called with the condition in words when the page has changed it. */
  onchange = () => {};

  constructor(element) {
    this.#inputs = Object.fromEntries(
      ["delay", "jitter", "loss", "rate"].map((name) => [name, element(`link-${name}`)]),
    );
    for (const input of Object.values(this.#inputs)) input.addEventListener("input", () => this.#changed());
    element("link-clear").addEventListener("click", () => this.set({ delay: 0, jitter: 0, loss: 0, rate: 0 }));
    this.#show();
  }

  /** Asks for a condition: milliseconds, milliseconds, percent, kbit/s or 0. */
  set(condition) {
    this.#put(condition);
    this.#changed();
  }

  /** Shows the condition that the server has now. */
  async read() {
    const response = await fetch("link", { cache: "no-store" });
    if (!response.ok) return;
    const text = await response.text();
    const value = (name) => Number.parseFloat(new RegExp(`(?:^|,)${name}=([0-9.]+)`).exec(text)?.[1] ?? "0");
    this.#put({ delay: value("delay"), jitter: value("jitter"), loss: value("loss"), rate: value("rate") / 1000 });
    this.#show();
  }

  #put({ delay, jitter, loss, rate: kilobits }) {
    const { rate, ...others } = this.#inputs;
    others.delay.value = delay;
    others.jitter.value = jitter;
    others.loss.value = loss;
    // The next slower one that the slider has.
    const slower = RATES.findIndex((of, at) => at > 0 && of <= kilobits);
    rate.value = kilobits === 0 ? 0 : slower < 0 ? RATES.length - 1 : slower;
  }

  #show() {
    const { delay, jitter, loss, rate } = this.#inputs;
    const show = (input, text) => (input.nextElementSibling.textContent = text);
    show(delay, `${delay.value} ms`);
    show(jitter, `${jitter.value} ms`);
    show(loss, `${loss.value} %`);
    const kilobits = RATES[rate.value];
    show(rate, kilobits === 0 ? "no limit" : kilobits >= 1000 ? `${kilobits / 1000} Mbit/s` : `${kilobits} kbit/s`);
  }

  #changed() {
    this.#show();
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#send(), CALM);
  }

  async #send() {
    const { delay, jitter, loss, rate } = this.#inputs;
    const condition = linkText({ delay: delay.value, jitter: jitter.value, loss: loss.value, rate: RATES[rate.value] });
    try {
      const response = await fetch("link", { method: "POST", body: condition });
      if (response.ok) this.onchange(condition);
      else this.onerror(await response.text());
    } catch {
      this.onerror("The server does not answer: the condition of the link is as it was.");
    }
  }
}
