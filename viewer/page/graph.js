// A graph of the last minute on a small canvas: lines over seconds, with both axes.

/** Points kept: a minute, four a second. */
const POINTS = 240;
/** Pixels around the lines: labels of the values at the left and right, of the seconds below. */
const LEFT = 44;
const RIGHT = 8;
const RIGHT_LABELS = 34;
const BELOW = 14;
const ABOVE = 5;
/** Decades of a logarithmic axis. */
const DECADES = 4;

export class Graph {
  #canvas;
  #lines;
  #values;
  #options;

  /**
   * `lines`: for each, the name of a colour of the style sheet, whether it is dashed, and whether it has an axis of its own, at
   * the right. `isLogarithmic`: equal steps are equal factors. `text`: a value as its axis names it; `ownText` at the right.
   */
  constructor(canvas, lines, options) {
    this.#canvas = canvas;
    this.#lines = lines;
    this.#values = lines.map(() => []);
    this.#options = options;
  }

  /** Adds a point to each line; undefined leaves a gap. */
  add(...values) {
    values.forEach((value, line) => {
      this.#values[line].push(value);
      if (this.#values[line].length > POINTS) this.#values[line].shift();
    });
  }

  clear() {
    for (const values of this.#values) values.length = 0;
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    if (width === 0) return;
    const scale = Math.min(globalThis.devicePixelRatio, 2);
    if (this.#canvas.width !== Math.round(width * scale)) {
      this.#canvas.width = Math.round(width * scale);
      this.#canvas.height = Math.round(height * scale);
    }
    const context = this.#canvas.getContext("2d");
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, width, height);
    const style = getComputedStyle(this.#canvas);
    const own = this.#lines.findIndex(({ own }) => own);
    const area = { left: LEFT, right: width - (own < 0 ? RIGHT : RIGHT_LABELS), top: ABOVE, bottom: height - BELOW };
    const shared = this.#axis(this.#lines.map((_, line) => line).filter((line) => line !== own));
    const other = own < 0 ? undefined : this.#axis([own]);
    this.#frame(context, style, area);
    this.#labels(context, style.getPropertyValue("--faint"), area, shared, this.#options.text, "left");
    if (other) this.#labels(context, style.getPropertyValue(this.#lines[own].colour), area, other, this.#options.ownText, "right");
    this.#lines.forEach(({ colour, dashed }, line) => {
      context.strokeStyle = style.getPropertyValue(colour);
      context.setLineDash(dashed ? [4, 3] : []);
      this.#line(context, area, line === own ? other : shared, this.#values[line]);
    });
    context.setLineDash([]);
  }

  /** The axis on which some lines are drawn: its ends, the values that it names, and a value's share of its height. */
  #axis(lines) {
    const all = lines.flatMap((line) => this.#values[line]).filter(Number.isFinite);
    const greatest = Math.max(...all, 1e-9);
    if (this.#options.isLogarithmic) {
      const top = Math.max(1, Math.ceil(Math.log10(Math.max(greatest, 1))));
      const bottom = Math.max(0, top - DECADES);
      const names = [];
      for (let decade = bottom; decade <= top; decade += 2) names.push(10 ** decade);
      const share = (value) => Math.min(1, Math.max(0, (Math.log10(Math.max(value, 1e-9)) - bottom) / (top - bottom)));
      return { names, share };
    }
    const top = roundAbove(greatest);
    return { names: [0, top / 2, top], share: (value) => value / top };
  }

  #frame(context, style, { left, right, top, bottom }) {
    context.strokeStyle = style.getPropertyValue("--line");
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(left + 0.5, top);
    context.lineTo(left + 0.5, bottom + 0.5);
    context.lineTo(right, bottom + 0.5);
    context.stroke();
    context.font = "10px system-ui, sans-serif";
    context.fillStyle = style.getPropertyValue("--faint");
    context.textBaseline = "top";
    for (const [share, text, align] of [[0, "60 s ago", "left"], [0.5, "30 s", "center"], [1, "now", "right"]]) {
      context.textAlign = align;
      context.fillText(text, left + share * (right - left), bottom + 3);
    }
  }

  #labels(context, colour, area, { names, share }, text, side) {
    context.fillStyle = colour;
    context.textBaseline = "middle";
    context.textAlign = side === "left" ? "right" : "left";
    for (const value of names) {
      const y = area.bottom - share(value) * (area.bottom - area.top);
      context.fillText(text(value), side === "left" ? area.left - 4 : area.right + 4, y);
      context.fillRect(side === "left" ? area.left - 2 : area.right, y, 3, 1);
    }
  }

  #line(context, { left, right, top, bottom }, { share }, values) {
    context.lineWidth = 1.5;
    context.beginPath();
    let isDrawing = false;
    values.forEach((value, at) => {
      if (!Number.isFinite(value)) {
        isDrawing = false;
        return;
      }
      const x = right - ((values.length - 1 - at) / (POINTS - 1)) * (right - left);
      const y = bottom - share(value) * (bottom - top);
      if (isDrawing) context.lineTo(x, y);
      else context.moveTo(x, y);
      isDrawing = true;
    });
    context.stroke();
  }
}

/** The next round number: 1, 2 or 5 of its decade. */
function roundAbove(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((step) => step * decade).find((round) => round >= value * (1 - 1e-9));
}
