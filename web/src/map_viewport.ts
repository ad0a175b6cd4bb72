// The part of a tactile map that the window shows: its middle and its scale, and the level and the view that go with them.
import { clamp, hasPin, middleOf, pinOf, viewAt, type Pin, type Point } from "./map_model";
import type { Level, TactileMap } from "./map_record";

const MARGIN = 0.03; // of the window around a view
const MAX_ENLARGEMENT = 4; // beyond the finest level

/** The window on a map, in pixels of the page; it moves and zooms within the views of the map. */
export class MapViewport {
  private opened: TactileMap | null = null;
  private shownLevel = 0;
  centre: Point = [0, 0];
  /** Units of the map in a pixel of the page. */
  scale = 1;

  /** `changed` is called after the viewport has moved. */
  constructor(private readonly element: HTMLElement, private readonly changed: () => void) {}

  /** Show a whole map. */
  open(map: TactileMap): void {
    this.opened = map;
    this.fit();
  }

  get map(): TactileMap {
    return this.opened!;
  }

  get width(): number {
    return this.element.clientWidth || 1;
  }

  get height(): number {
    return this.element.clientHeight || 1;
  }

  /** Units in a pixel at which a view of each level fills the window. */
  get scales(): number[] {
    const pins = Math.max(this.map.columns / this.width, this.map.rows / this.height) * (1 + 2 * MARGIN);
    return this.map.levels.map(({ pinStep }) => pinStep * pins);
  }

  /** Number of the level whose views fill the window best. */
  get levelNumber(): number {
    const distances = this.scales.map((scale) => Math.abs(Math.log(scale / this.scale)));
    return distances.indexOf(Math.min(...distances));
  }

  get level(): Level {
    return this.map.levels[this.levelNumber]!;
  }

  /** Row and column of the view that a display shows: the one whose middle is nearest to that of the window. */
  get at(): Pin {
    return viewAt(this.map, this.level, this.centre);
  }

  /** Show the whole map. */
  fit(): void {
    this.scale = this.scales[0]!;
    this.moveTo(middleOf(this.map, this.map.levels[0]!, [0, 0]));
  }

  /** Go to a level, with a point of the map in the view. */
  goTo(level: number, about: Point): void {
    this.scale = this.scales[level]!;
    this.show(viewAt(this.map, this.level, about));
  }

  /** Show a view in the middle of the window. */
  show(at: Pin): void {
    this.moveTo(middleOf(this.map, this.level, at));
  }

  /** Change the scale by a factor; a point of the map stays where it is in the window. */
  zoom(factor: number, about: Point): void {
    const next = clamp(this.scale * factor, Math.min(...this.scales) / MAX_ENLARGEMENT, this.scales[0]!);
    const ratio = next / this.scale;
    this.scale = next;
    this.moveTo([about[0] + (this.centre[0] - about[0]) * ratio, about[1] + (this.centre[1] - about[1]) * ratio]);
  }

  /** Move the window to a point of the map, at most to the middle of the outermost views: each of them can be shown. */
  moveTo([x, y]: Point): void {
    const { map, level } = this;
    this.shownLevel = this.levelNumber;
    const [west, north] = middleOf(map, level, [0, 0]);
    const [east, south] = middleOf(map, level, [level.viewRows - 1, level.viewColumns - 1]);
    this.centre = [clamp(x, west, east), clamp(y, south, north)];
    this.changed();
  }

  /** Move the window to the next view if a point has left the one that is shown, or the window. */
  reveal(point: Point): void {
    const [pin, [x, y]] = [pinOf(this.map, this.level, point), this.toPixel(point)];
    const isSeen = x >= 0 && x <= this.width && y >= 0 && y <= this.height;
    if (!hasPin(this.map, this.level, this.at, pin)) this.show(viewAt(this.map, this.level, point));
    if (!isSeen) this.moveTo(point);
  }

  /** The point of the map under a pixel of the canvas. */
  toMap(x: number, y: number): Point {
    return [this.centre[0] + this.scale * (x - this.width / 2), this.centre[1] - this.scale * (y - this.height / 2)];
  }

  toPixel([x, y]: Point): Point {
    return [this.width / 2 + (x - this.centre[0]) / this.scale, this.height / 2 - (y - this.centre[1]) / this.scale];
  }

  /** Keep level and middle when the size of the element has changed. */
  resize(): void {
    if (this.opened) this.goTo(this.shownLevel, this.centre);
  }
}
