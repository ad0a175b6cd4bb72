// Where pins and views of a tactile map lie, what is under a pin, and how far places are. Pins of a level have rows and columns
// counted from its first view; x is to the right or east, y up or north, in units of the map.
import { readView, UP, type Box, type Level, type MapSymbol, type Place, type TactileMap, type View } from "./map_record";

export type Point = [number, number];

/** Row and column of a pin of a level. */
export type Pin = [number, number];

/** What is under a pin: a symbol, and the names of it that may be there. */
export interface Met {
  symbol: MapSymbol;
  names: string[];
  pin: Pin;
}

const MAX_VIEWS_KEPT = 128;
const PRIORITY = { point: 0, label: 1, line: 2, area: 3 };

/** Views of a map that have been expanded. */
export class Views {
  private readonly views = new Map<number, View>();
  private readonly loading = new Map<number, Promise<View | null>>();

  /** `arrived` is called when a view that was missing is there, and `failed` when it is damaged. */
  constructor(readonly map: TactileMap, private readonly arrived: () => void, private readonly failed: (error: unknown) => void) {}

  /** A view if it is there; if not, it will come. */
  get(index: number): View | null {
    const view = this.views.get(index);
    if (!view) void this.load(index).then((loaded) => loaded && this.arrived());
    return view ?? null;
  }

  /** A view; null if it is damaged. */
  load(index: number): Promise<View | null> {
    const view = this.views.get(index);
    if (view) return Promise.resolve(view);
    let promise = this.loading.get(index);
    if (!promise) {
      promise = readView(this.map, index).then(
        (loaded) => this.keep(index, loaded),
        (error: unknown) => (this.failed(error), null),
      );
      this.loading.set(index, promise);
    }
    return promise;
  }

  private keep(index: number, view: View): View {
    this.loading.delete(index);
    this.views.set(index, view);
    if (this.views.size > MAX_VIEWS_KEPT) this.views.delete(this.views.keys().next().value!);
    return view;
  }
}

// -- geometry -------------------------------------------------------------------------------------------------------------

export const clamp = (value: number, low: number, high: number): number => Math.min(Math.max(value, low), high);

export const rowsOf = (map: TactileMap, level: Level): number => (level.viewRows - 1) * level.panRows + map.rows;
export const columnsOf = (map: TactileMap, level: Level): number => (level.viewColumns - 1) * level.panColumns + map.columns;

/** The part of the map that its first level shows. */
export function boxOf(map: TactileMap): Box {
  const { west, north, pinStep } = map.levels[0]!;
  const half = pinStep / 2;
  return [west - half, north - pinStep * (rowsOf(map, map.levels[0]!) - 1) - half, west + pinStep * (columnsOf(map, map.levels[0]!) - 1) + half, north + half];
}

export const pointOf = ({ west, north, pinStep }: Level, [row, column]: Pin): Point => [west + column * pinStep, north - row * pinStep];

/** The pin of a level that is nearest to a point. */
export function pinOf(map: TactileMap, level: Level, [x, y]: Point): Pin {
  const [row, column] = [(level.north - y) / level.pinStep, (x - level.west) / level.pinStep];
  return [clamp(Math.round(row), 0, rowsOf(map, level) - 1), clamp(Math.round(column), 0, columnsOf(map, level) - 1)];
}

/** Row and column of the view of a level whose middle is nearest to a point. */
export function viewAt(map: TactileMap, level: Level, [x, y]: Point): Pin {
  const row = ((level.north - y) / level.pinStep - (map.rows - 1) / 2) / level.panRows;
  const column = ((x - level.west) / level.pinStep - (map.columns - 1) / 2) / level.panColumns;
  return [clamp(Math.round(row), 0, level.viewRows - 1), clamp(Math.round(column), 0, level.viewColumns - 1)];
}

export const middleOf = (map: TactileMap, level: Level, [a, b]: Pin): Point =>
  pointOf(level, [a * level.panRows + (map.rows - 1) / 2, b * level.panColumns + (map.columns - 1) / 2]);

export const indexOf = (level: Level, [a, b]: Pin): number => level.first + a * level.viewColumns + b;

/** The pin of number `n`, row by row, of the view at a row and column. */
export const pinAt = (map: TactileMap, level: Level, at: Pin, n: number): Pin => [at[0] * level.panRows + Math.floor(n / map.columns), at[1] * level.panColumns + (n % map.columns)];

/** Whether a view has a pin. */
export function hasPin(map: TactileMap, level: Level, [a, b]: Pin, [row, column]: Pin): boolean {
  const [top, left] = [a * level.panRows, b * level.panColumns];
  return row >= top && row < top + map.rows && column >= left && column < left + map.columns;
}

export const centreOf = ([west, south, east, north]: Box): Point => [(west + east) / 2, (south + north) / 2];

// -- what is there --------------------------------------------------------------------------------------------------------

/** The symbol of a pin in a view; null: none. */
export function symbolAt(map: TactileMap, level: Level, view: View, at: Pin, [row, column]: Pin): MapSymbol | null {
  const n = (row - at[0] * level.panRows) * map.columns + column - at[1] * level.panColumns;
  return view.symbols[(view.pins[n]! & ~UP) - 1] ?? null;
}

/** Whether two symbols, also of two views, show the same. */
export const isLike = (a: MapSymbol, b: MapSymbol): boolean => a.kind === b.kind && a.role === b.role && a.names.join() === b.names.join();

/** What is under a pin, or beside it within some pins: points first, then lines, then areas, and of each the nearest; or what is
 * like a symbol. */
export function metAt(map: TactileMap, level: Level, view: View, at: Pin, pin: Pin, reach: number, like: MapSymbol | null = null): Met | null {
  let [best, rank]: [Met | null, number] = [null, Infinity];
  const whole = Math.floor(reach);
  for (let i = -whole; i <= whole; i++) {
    for (let j = -whole; j <= whole; j++) {
      const beside: Pin = [pin[0] + i, pin[1] + j];
      const distance = Math.hypot(i, j);
      if (distance > reach || !hasPin(map, level, at, beside)) continue;
      const symbol = symbolAt(map, level, view, at, beside);
      if (!symbol || (like ? !isLike(symbol, like) : symbol.role === "area" && distance > 0)) continue;
      const own = 1000 * PRIORITY[symbol.role] + distance;
      if (own < rank) [best, rank] = [{ symbol, names: [], pin: beside }, own];
    }
  }
  return best && { ...best, names: namesAt(map, level, best) };
}

const NAME_REACH = 2; // pins around the box of a place in which its name is meant
const PLACE_REACH = 6; // pins by which a point symbol or a label may stand beside its place

/** Names of a symbol at a pin: its only one, or those of the places whose box is there. */
function namesAt(map: TactileMap, level: Level, { symbol, pin }: Met): string[] {
  if (symbol.names.length < 2) return symbol.names;
  const point = pointOf(level, pin);
  const margin = NAME_REACH * level.pinStep;
  const own = map.places.filter(({ name, kind, box }) => kind === symbol.kind && symbol.names.includes(name) && distanceToBox(point, box) <= margin);
  return [...new Set(own.sort((a, b) => sizeOf(a.box) - sizeOf(b.box)).map(({ name }) => name))];
}

const sizeOf = ([west, south, east, north]: Box): number => east - west + north - south;

const distanceToBox = ([x, y]: Point, [west, south, east, north]: Box): number =>
  Math.hypot(Math.max(west - x, 0, x - east), Math.max(south - y, 0, y - north));

/** The pin of a view that shows a place, the one nearest to the middle of its box; null if it is not drawn there. */
export function pinOfPlace(map: TactileMap, level: Level, view: View, at: Pin, place: Place): Pin | null {
  const isNamed = ({ kind, names }: MapSymbol): boolean => kind === place.kind && names.includes(place.name);
  const symbol = view.symbols.map((own) => isNamed(own) && own.role !== "label");
  const label = view.symbols.map((own) => isNamed(own) && own.role === "label"); // a word of a drawing has no symbol
  return nearestPin(map, level, view, at, place, symbol) ?? nearestPin(map, level, view, at, place, label);
}

function nearestPin(map: TactileMap, level: Level, view: View, at: Pin, { box }: Place, isWanted: boolean[]): Pin | null {
  const [x, y] = centreOf(box);
  let [best, least]: [Pin | null, number] = [null, Infinity];
  for (const [n, word] of view.pins.entries()) {
    if (!isWanted[(word & ~UP) - 1]) continue;
    const pin = pinAt(map, level, at, n);
    const point = pointOf(level, pin);
    if (distanceToBox(point, box) > PLACE_REACH * level.pinStep) continue; // another one of the same name
    const distance = Math.hypot(point[0] - x, point[1] - y);
    if (distance < least) [best, least] = [pin, distance];
  }
  return best;
}

/** Places in the order of the alphabet. */
export function sortedPlaces({ places, language }: TactileMap): Place[] {
  let locales: string[] = [];
  try {
    locales = Intl.getCanonicalLocales(language);
  } catch {
    // a table of liblouis
  }
  const { compare } = new Intl.Collator(locales, { numeric: true });
  return [...places].sort((a, b) => compare(a.name, b.name));
}

/** The place whose middle is nearest to a point, but for those of some names. */
export function nearestPlace({ places }: TactileMap, from: Point, names: string[]): Place | null {
  let [best, least]: [Place | null, number] = [null, Infinity];
  for (const place of places) {
    if (names.includes(place.name)) continue;
    const distance = Math.hypot(...[0, 1].map((n) => centreOf(place.box)[n]! - from[n]!));
    if (distance < least) [best, least] = [place, distance];
  }
  return best;
}
