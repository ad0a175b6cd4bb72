// Draws the pins of a map on a canvas, coloured by class: the view that a display shows, and more faintly what is around it;
// the cursor, the way to a place, and names.
import { classOf } from "./map_classes";
import { boxOf, hasPin, indexOf, pinAt, pointOf, symbolAt, type Pin, type Point, type Views } from "./map_model";
import { UP, type Box, type MapSymbol, type View } from "./map_record";
import type { MapViewport } from "./map_viewport";

const MIN_NAME_PX = 6; // between pins, below which no names are written
const PIN_RADIUS = 0.4; // of the distance between pins
const AROUND = 0.35; // opacity of what no display shows now

export interface Marks {
  cursor: Pin;
  met: MapSymbol | null;
  target: Point | null;
}

/** A map on a canvas. */
export class MapView {
  private readonly context: CanvasRenderingContext2D;
  private views: Views | null = null;
  private isDue = false;
  private marks: Marks = { cursor: [0, 0], met: null, target: null };

  constructor(private readonly canvas: HTMLCanvasElement, private readonly viewport: MapViewport) {
    this.context = canvas.getContext("2d")!;
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  open(views: Views): void {
    this.views = views;
    this.viewport.open(views.map);
  }

  mark(marks: Marks): void {
    this.marks = marks;
    this.redraw();
  }

  private resize(): void {
    const { canvas, viewport } = this;
    const ratio = devicePixelRatio || 1;
    canvas.width = Math.round(viewport.width * ratio);
    canvas.height = Math.round(viewport.height * ratio);
    viewport.resize();
  }

  /** Draw the map before the next picture. */
  redraw(): void {
    if (this.isDue || !this.views) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.draw();
    });
  }

  private draw(): void {
    const { context } = this;
    const ratio = devicePixelRatio || 1;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.viewport.width, this.viewport.height);
    const style = getComputedStyle(this.canvas);
    const ink = (name: string): string => style.getPropertyValue(name).trim();
    const scheme = style.colorScheme.includes("dark") ? 1 : 0;
    const { level, at } = this.viewport;
    this.drawSheet(boxOf(this.viewport.map), ink("--sheet"), ink("--line"));
    context.globalAlpha = AROUND;
    const drawn: Pin[] = [at];
    for (const other of this.around(at)) {
      this.drawPins(other, scheme, ink, drawn);
      drawn.push(other);
    }
    context.globalAlpha = 1;
    this.drawFrame(at, ink("--sheet"), ink("--frame"));
    this.drawPins(at, scheme, ink, []);
    const view = this.views!.get(indexOf(level, at));
    if (view && level.pinStep / this.viewport.scale >= MIN_NAME_PX) this.drawNames(view, at, ink);
    this.drawTarget(ink("--focus"));
    this.drawCursor(ink);
  }

  /** The views beside a view that have most of what it does not show. */
  private around([a, b]: Pin): Pin[] {
    const { level, map } = this.viewport;
    const [down, right] = [Math.max(1, Math.floor(map.rows / level.panRows)), Math.max(1, Math.floor(map.columns / level.panColumns))];
    const within = (n: number, count: number): number => Math.min(Math.max(n, 0), count - 1);
    const found = new Map<string, Pin>();
    for (const i of [0, -down, down]) {
      for (const j of [0, -right, right]) {
        const other: Pin = [within(a + i, level.viewRows), within(b + j, level.viewColumns)];
        if (other[0] !== a || other[1] !== b) found.set(other.join(), other);
      }
    }
    return [...found.values()];
  }

  private drawSheet(box: Box, fill: string, line: string): void {
    const { viewport } = this;
    this.drawPlate(viewport.toPixel([box[0], box[3]]), viewport.toPixel([box[2], box[1]]), fill, line, { margin: 6, radius: 6, width: 1 });
  }

  /** The edge of a display that shows a view. */
  private drawFrame([a, b]: Pin, fill: string, line: string): void {
    const { map, level } = this.viewport;
    const top: Pin = [a * level.panRows - 0.5, b * level.panColumns - 0.5];
    const corner = (pin: Pin) => this.viewport.toPixel(pointOf(level, pin));
    this.drawPlate(corner(top), corner([top[0] + map.rows, top[1] + map.columns]), fill, line, { margin: 5, radius: 8, width: 2 });
  }

  /** A rounded rectangle around two corners, the upper left and the lower right one, in pixels. */
  private drawPlate([left, top]: Point, [right, bottom]: Point, fill: string, line: string, edge: { margin: number; radius: number; width: number }): void {
    const { context } = this;
    context.fillStyle = fill;
    context.strokeStyle = line;
    context.lineWidth = edge.width;
    context.beginPath();
    context.roundRect(left - edge.margin, top - edge.margin, right - left + 2 * edge.margin, bottom - top + 2 * edge.margin, edge.radius);
    context.fill();
    context.stroke();
  }

  /** Pins of a view that are in the window, but for those of other views. */
  private drawPins(at: Pin, scheme: 0 | 1, ink: (name: string) => string, others: Pin[]): void {
    const { level, map } = this.viewport;
    const view = this.views!.get(indexOf(level, at));
    if (!view) return;
    const size = level.pinStep / this.viewport.scale;
    const [low, high, label, accent] = [ink("--down"), ink("--ink"), ink("--label"), ink("--accent")];
    const paths = new Map<string, Path2D>();
    for (const [n, word] of view.pins.entries()) {
      const pin = pinAt(map, level, at, n);
      const [x, y] = this.viewport.toPixel(pointOf(level, pin));
      if (x < -size || y < -size || x > this.viewport.width + size || y > this.viewport.height + size) continue;
      if (others.some((other) => hasPin(map, level, other, pin))) continue;
      const symbol = view.symbols[(word & ~UP) - 1];
      const isUp = (word & UP) !== 0;
      const colour = !symbol ? high : symbol.role === "label" ? label : classOf(symbol.kind.name).colours[scheme];
      if (symbol && symbol.role === "area") addTo(paths, `ground ${colour}`).rect(x - size / 2, y - size / 2, size + 0.3, size + 0.3);
      if (symbol && symbol === this.marks.met && isUp) addDisc(addTo(paths, `met ${accent}`), x, y, 0.56 * size);
      addDisc(addTo(paths, isUp ? `up ${colour}` : `down ${symbol ? colour : low}`), x, y, size * (isUp ? PIN_RADIUS : 0.1));
    }
    this.fill(paths);
  }

  private fill(paths: Map<string, Path2D>): void {
    const { context } = this;
    const alpha = context.globalAlpha;
    for (const layer of ["ground", "down", "met", "up"]) {
      for (const [key, path] of paths) {
        if (!key.startsWith(`${layer} `)) continue;
        context.globalAlpha = alpha * (layer === "ground" ? 0.22 : layer === "down" ? 0.55 : 1);
        context.fillStyle = key.slice(layer.length + 1);
        context.fill(path);
      }
    }
    context.globalAlpha = alpha;
  }

  /** A name for each symbol of one name, beside the pin that is nearest to its middle. */
  private drawNames(view: View, at: Pin, ink: (name: string) => string): void {
    const { context } = this;
    const size = this.viewport.level.pinStep / this.viewport.scale;
    context.font = `600 ${Math.round(Math.min(Math.max(size, 12), 18))}px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineJoin = "round";
    const taken: Box[] = [];
    for (const [name, role, point] of this.namePoints(view, at)) {
      const [x, y] = this.viewport.toPixel(point);
      const half = context.measureText(name).width / 2 + 4;
      const middle = role === "area" ? y : y + 1.2 * size + 10;
      const own: Box = [x - half, middle - 10, x + half, middle + 10];
      const fits = own[0] > 0 && own[2] < this.viewport.width && own[1] > 0 && own[3] < this.viewport.height;
      if (!fits || taken.some((box) => own[0] < box[2] && own[2] > box[0] && own[1] < box[3] && own[3] > box[1])) continue;
      taken.push(own);
      context.lineWidth = 5;
      context.strokeStyle = ink("--sheet");
      context.strokeText(name, x, middle);
      context.fillStyle = ink("--ink");
      context.fillText(name, x, middle);
    }
  }

  /** Names with their roles and where they stand, points first. */
  private namePoints(view: View, at: Pin): [string, string, Point][] {
    const { level, map } = this.viewport;
    const middles = new Map<string, { role: string; sum: Point; count: number; pins: Pin[] }>();
    for (let n = 0; n < view.pins.length; n++) {
      const pin = pinAt(map, level, at, n);
      const symbol = symbolAt(map, level, view, at, pin);
      if (symbol?.names.length !== 1 || symbol.role === "label") continue;
      const name = symbol.names[0]!;
      if (!middles.has(name)) middles.set(name, { role: symbol.role, sum: [0, 0], count: 0, pins: [] });
      const own = middles.get(name)!;
      own.sum = [own.sum[0] + pin[0], own.sum[1] + pin[1]];
      own.count++;
      own.pins.push(pin);
    }
    const order = ["point", "area", "line"];
    return [...middles]
      .sort(([, a], [, b]) => order.indexOf(a.role) - order.indexOf(b.role) || b.count - a.count)
      .map(([name, { role, sum, count, pins }]) => [name, role, pointOf(level, nearestPin(pins, [sum[0] / count, sum[1] / count]))]);
  }

  private drawTarget(colour: string): void {
    const { target, cursor } = this.marks;
    if (!target) return;
    const { context } = this;
    const [[x, y], [from, down]] = [this.viewport.toPixel(target), this.viewport.toPixel(pointOf(this.viewport.level, cursor))];
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = 2.5;
    context.setLineDash([8, 6]);
    context.beginPath();
    context.moveTo(from, down);
    context.lineTo(x, y);
    context.stroke();
    context.setLineDash([]);
    context.beginPath();
    context.arc(x, y, 7, 0, 7);
    context.fill();
  }

  private drawCursor(ink: (name: string) => string): void {
    const { context } = this;
    const [x, y] = this.viewport.toPixel(pointOf(this.viewport.level, this.marks.cursor));
    const radius = Math.max(14, (0.9 * this.viewport.level.pinStep) / this.viewport.scale);
    for (const [colour, width] of [[ink("--sheet"), 7], [ink("--accent"), 3]] as const) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.beginPath();
      context.arc(x, y, radius, 0, 7);
      for (const [i, j] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) {
        context.moveTo(x + 0.7 * radius * i, y + 0.7 * radius * j);
        context.lineTo(x + 1.7 * radius * i, y + 1.7 * radius * j);
      }
      context.stroke();
    }
  }
}

function addTo(paths: Map<string, Path2D>, key: string): Path2D {
  if (!paths.has(key)) paths.set(key, new Path2D());
  return paths.get(key)!;
}

function addDisc(path: Path2D, x: number, y: number, radius: number): void {
  path.moveTo(x + radius, y);
  path.arc(x, y, radius, 0, 7);
}

function nearestPin(pins: Pin[], [row, column]: Point): Pin {
  const distance = (pin: Pin): number => Math.hypot(pin[0] - row, pin[1] - column);
  return pins.reduce((best, pin) => (distance(pin) < distance(best) ? pin : best));
}
