// Draws the last two seconds of |F|, the force at the probe, as a moving line.
const SECONDS = 2;

export class Trace {
  private points: [number, number][] = [];
  private peak = 1;
  private isDue = false;

  constructor(private readonly canvas: HTMLCanvasElement) {}

  start(peak: number): void {
    this.points = [];
    this.peak = peak;
    this.draw();
  }

  add(size: number): void {
    this.points.push([performance.now(), size]);
    this.due();
  }

  private due(): void {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.draw();
      const last = this.points.at(-1);
      const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
      if (!isStill && last && performance.now() - last[0] < 1000 * SECONDS) this.due();
    });
  }

  private draw(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const paint = this.canvas.getContext("2d")!;
    const now = performance.now();
    this.canvas.width = width * devicePixelRatio;
    this.canvas.height = height * devicePixelRatio;
    paint.scale(devicePixelRatio, devicePixelRatio);
    while (this.points.length > 1 && now - this.points[1]![0] > 1000 * SECONDS) this.points.shift();
    paint.strokeStyle = getComputedStyle(this.canvas).getPropertyValue("--accent") || "#c2410c";
    paint.lineWidth = 1.8;
    paint.beginPath();
    this.points.forEach(([at, size], n) => {
      const x = width * (1 - (now - at) / (1000 * SECONDS));
      if (n) paint.lineTo(x, levelOf(this.points[n - 1]![1], height, this.peak));
      paint.lineTo(x, levelOf(size, height, this.peak));
    });
    const last = this.points.at(-1);
    if (last) paint.lineTo(width, levelOf(last[1], height, this.peak));
    paint.stroke();
  }
}

/** Where a force is drawn; it stays until the next one, so that the line goes in steps. */
function levelOf(size: number, height: number, peak: number): number {
  return height - 3 - (height - 6) * Math.min(size / peak, 1);
}
