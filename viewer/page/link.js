// The condition of the page's link: delay, jitter, loss and rate, which the server's relay applies.

/** Rates in kbit/s, by the position of the slider; the first is no limit. */
const RATES = [0, 10000, 5000, 2000, 1000, 500, 300, 200, 128, 64, 48, 32, 16];
/** Milliseconds of calm before a change is sent. */
const CALM = 150;

export class Link {
  #inputs;
  #timer;
  /** Called with a sentence if the server refuses. */
  onerror = () => {};

  constructor(element) {
    this.#inputs = Object.fromEntries(
      ["delay", "jitter", "loss", "rate"].map((name) => [name, element(`link-${name}`)]),
    );
    for (const input of Object.values(this.#inputs)) input.addEventListener("input", () => this.#changed());
    element("link-clear").addEventListener("click", () => {
      for (const input of Object.values(this.#inputs)) input.value = 0;
      this.#changed();
    });
    this.#show();
  }

  /** Shows the condition that the server has now. */
  async read() {
    const response = await fetch("link", { cache: "no-store" });
    if (!response.ok) return;
    const text = await response.text();
    const { delay, jitter, loss, rate } = this.#inputs;
    const value = (name) => Number.parseFloat(new RegExp(`(?:^|,)${name}=([0-9.]+)`).exec(text)?.[1] ?? "0");
    delay.value = value("delay");
    jitter.value = value("jitter");
    loss.value = value("loss");
    const kilobits = value("rate") / 1000;
    rate.value = kilobits === 0 ? 0 : RATES.findIndex((of, at) => at > 0 && of <= kilobits);
    this.#show();
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
    const kilobits = RATES[rate.value];
    const limit = kilobits === 0 ? "" : `,rate=${kilobits}kbit`;
    const body = `delay=${delay.value}ms,jitter=${jitter.value}ms,loss=${loss.value}%${limit}`;
    try {
      const response = await fetch("link", { method: "POST", body });
      if (!response.ok) this.onerror(await response.text());
    } catch {
      this.onerror("The server does not answer: the condition of the link is as it was.");
    }
  }
}
