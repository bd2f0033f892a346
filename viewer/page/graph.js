// A graph of the last minute on a small canvas: lines over seconds.

/** Points kept: a minute, four a second. */
const POINTS = 240;

export class Graph {
  #canvas;
  #lines;
  #values;

  /** `lines`: for each, the name of a colour of the style sheet, and whether it is dashed. */
  constructor(canvas, lines) {
    this.#canvas = canvas;
    this.#lines = lines;
    this.#values = lines.map(() => []);
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
    context.strokeStyle = style.getPropertyValue("--line");
    context.lineWidth = 1;
    context.strokeRect(0.5, 0.5, width - 1, height - 1);
    this.#lines.forEach(({ colour, dashed, own }, line) => {
      const scaled = own ? [line] : this.#lines.map((_, at) => at).filter((other) => !this.#lines[other].own);
      const all = scaled.flatMap((other) => this.#values[other]).filter(Number.isFinite);
      const greatest = Math.max(...all, 1e-9);
      context.strokeStyle = style.getPropertyValue(colour);
      context.setLineDash(dashed ? [4, 3] : []);
      context.lineWidth = 1.5;
      context.beginPath();
      let isDrawing = false;
      this.#values[line].forEach((value, at) => {
        if (!Number.isFinite(value)) {
          isDrawing = false;
          return;
        }
        const x = width - ((this.#values[line].length - 1 - at) / (POINTS - 1)) * width;
        const y = height - 2 - (value / greatest) * (height - 6);
        if (isDrawing) context.lineTo(x, y);
        else context.moveTo(x, y);
        isDrawing = true;
      });
      context.stroke();
    });
    context.setLineDash([]);
  }
}
