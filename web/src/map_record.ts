// Reads the record TMAP of a file: levels, views and index of a tactile map (docs/format/maps.md). Views are expanded one by one.
import { crc32, Fault, faultOf, rows } from "./container";

export interface Kind {
  name: string;
  title: string;
}

/** Features of one name and class, such as the parts of a street. */
export interface Place {
  name: string;
  kind: Kind;
  /** Number of the first level that draws it; the number of levels if none does. */
  firstLevel: number;
  box: Box;
}

/** West, south, east, north. */
export type Box = [number, number, number, number];

/** A grid of views of one scale; lengths in units of the map. */
export interface Level {
  pinStep: number;
  west: number;
  north: number;
  panRows: number;
  panColumns: number;
  viewRows: number;
  viewColumns: number;
  /** Index of its first view. */
  first: number;
}

export interface TactileMap {
  title: string;
  attribution: string;
  language: string;
  isDrawing: boolean;
  rows: number;
  columns: number;
  kinds: Kind[];
  names: string[];
  places: Place[];
  levels: Level[];
  views: Uint8Array<ArrayBuffer>[];
}

export type Role = "line" | "area" | "point" | "label";

export interface MapSymbol {
  role: Role;
  kind: Kind;
  /** Of a line those of all lines that it joins. */
  names: string[];
}

/** A view; `pins` has for each pin, from the top left, bit 15 if it is up, and 1 + the index of its symbol. */
export interface View {
  symbols: MapSymbol[];
  pins: Uint16Array;
}

export const UP = 0x8000;
const TAG = "TMAP";
const MAGIC = [0x89, 0x54, 0x4f, 0x55, 0x43, 0x48, 0x0d, 0x0a, 0x1a, 0x0a];
const OPENING = 14;
const OVERHEAD = 20;
const MAX_RECORD_BYTES = 2 ** 26;
const MAX_PINS = 2 ** 14;
const MAX_INDEX = 2 ** 16;
const MAX_VIEWS = 4096;
const MAX_VIEW_BYTES = 2 ** 20;
const MAX_SIDE = 1024;
const MAX_SYMBOLS_BYTES = 2 ** 18;
const MAX_POSITION = 1e9;
const ROLES: Role[] = ["line", "area", "point", "label"];

const corrupt = (text: string): Fault => new Fault("corrupt", `the map in it is damaged: ${text}. Make it again: touchfield map.`, null);

/** Fields of a payload, one after the other, within their bounds. */
class Fields {
  private at = 0;
  private readonly view: DataView;
  private readonly decoder = new TextDecoder("utf-8", { fatal: true });

  constructor(private readonly data: Uint8Array<ArrayBuffer>) {
    this.view = new DataView(data.buffer, data.byteOffset, data.length);
  }

  get left(): number {
    return this.data.length - this.at;
  }

  u8 = (name: string, low: number, high: number): number => within(name, this.view.getUint8(this.skip(1)), low, high);
  u16 = (name: string, low: number, high: number): number => within(name, this.view.getUint16(this.skip(2), true), low, high);
  u32 = (name: string, low: number, high: number): number => within(name, this.view.getUint32(this.skip(4), true), low, high);
  f64 = (name: string, low: number, high: number): number => within(name, this.view.getFloat64(this.skip(8), true), low, high);

  /** Bytes, after their number if that is not known. */
  octets(name: string, max: number, size = this.u32(name, 0, max)): Uint8Array<ArrayBuffer> {
    const at = this.skip(size);
    return this.data.subarray(at, at + size);
  }

  text(name: string, max: number): string {
    const bytes = this.octets(name, max, this.u16(name, 0, max));
    try {
      const text = this.decoder.decode(bytes);
      if (!/[\0-\x1f\x7f-\x9f]/.test(text)) return text;
    } catch {
      // reported below
    }
    throw corrupt(`${name} is not text`);
  }

  /** A list of a number of items, of which each takes a byte or more. */
  list<T>(name: string, count: number, read: (n: number) => T): T[] {
    if (count > this.left) throw corrupt(`${count} ${name}, and ${this.left} bytes`);
    return Array.from({ length: count }, (_, n) => read(n));
  }

  private skip(size: number): number {
    if (size > this.left) throw corrupt("it ends too early");
    const at = this.at;
    this.at += size;
    return at;
  }
}

function within(name: string, value: number, low: number, high: number): number {
  if (value >= low && value <= high) return value;
  throw corrupt(`${name} is ${value}, not ${low} to ${high}`);
}

/** The map of a file; throws a `Fault` if there is none, or it is damaged. */
export function readMap(data: Uint8Array<ArrayBuffer>): TactileMap {
  if (!MAGIC.every((byte, n) => data[n] === byte)) throw new Fault("foreign", "it is no .touch file.", 0);
  return mapOf(payloadOf(data));
}

function payloadOf(data: Uint8Array<ArrayBuffer>): Uint8Array<ArrayBuffer> {
  if (data.length >= OPENING) {
    const view = new DataView(data.buffer, data.byteOffset, data.length);
    const found = [...rows(data)].filter(({ tag }) => tag === TAG);
    if (found.length > 1) throw corrupt("there are two");
    for (const { at, length } of found) {
      const end = at + OVERHEAD + length;
      if (end > data.length || crc32(data.subarray(at, end - 4)) !== view.getUint32(end - 4, true)) break;
      if (length > MAX_RECORD_BYTES) throw corrupt(`it has ${length} bytes`);
      return data.subarray(at + 16, end - 4);
    }
  }
  const fault = faultOf("corrupt", "the file is damaged or cut short. Copy it again.", data);
  if (fault.byte !== null) throw fault;
  throw new Fault("argument", "it has no map. touchfield map makes one; touchfield view shows other files.", null);
}

function mapOf(payload: Uint8Array<ArrayBuffer>): TactileMap {
  const from = new Fields(payload);
  const version = from.u8("version", 1, 255);
  if (version !== 1) throw new Fault("other version", `its map has version ${version}; this page reads version 1. Use a later touchfield.`, null);
  const [title, attribution, language] = [from.text("title", 256), from.text("attribution", 256), from.text("language", 64)];
  const isDrawing = from.u8("is_drawing", 0, 1) === 1;
  for (let n = 0; n < 2; n++) from.f64("origin_deg", -180, 180);
  const [pinRows, columns] = [from.u16("rows", 1, MAX_SIDE), from.u16("columns", 1, MAX_SIDE)];
  if (pinRows * columns > MAX_PINS) throw corrupt(`${pinRows} x ${columns} pins`);
  from.f64("pitch_mm", 0.1, 100);
  const kinds = from.list("kinds", from.u16("kinds", 0, 256), () => kindOf(from));
  const names = from.list("names", from.u32("names", 0, MAX_INDEX), () => {
    const name = from.text("name", 512);
    from.octets("cells", 1024);
    return name;
  });
  const places = from.list("places", from.u32("places", 0, MAX_INDEX), () => placeOf(from, names, kinds));
  let count = 0;
  const levels = from.list("levels", from.u16("levels", 1, 8), () => {
    const level = levelOf(from, count);
    count += level.viewRows * level.viewColumns;
    return level;
  });
  const views = from.list("views", from.u32("views", 0, MAX_VIEWS), () => from.octets("view", MAX_VIEW_BYTES));
  if (views.length !== count) throw corrupt(`${views.length} views in place of ${count}`);
  if (from.left) throw corrupt(`${from.left} bytes after its end`);
  if (places.some(({ firstLevel }) => firstLevel > levels.length)) throw corrupt("a place on a level that is not there");
  return { title, attribution, language, isDrawing, rows: pinRows, columns, kinds, names, places, levels, views };
}

function kindOf(from: Fields): Kind {
  const [name, title] = [from.text("class", 32), from.text("title", 64)];
  from.octets("cells", 256);
  return { name, title };
}

function placeOf(from: Fields, names: string[], kinds: Kind[]): Place {
  const [name, kind] = [names[from.u32("name", 0, names.length - 1)]!, kinds[from.u16("class", 0, kinds.length - 1)]!];
  const firstLevel = from.u8("first_level", 0, 8);
  const box = [0, 1, 2, 3].map(() => from.f64("box", -MAX_POSITION, MAX_POSITION)) as Box;
  if (box[0] > box[2] || box[1] > box[3]) throw corrupt("a place whose box is reversed");
  return { name, kind, firstLevel, box };
}

function levelOf(from: Fields, first: number): Level {
  const pinStep = from.f64("pin_step", 1e-9, MAX_POSITION);
  const [west, north] = [from.f64("west", -MAX_POSITION, MAX_POSITION), from.f64("north", -MAX_POSITION, MAX_POSITION)];
  const [panRows, panColumns] = [from.u16("pan_rows", 1, MAX_SIDE), from.u16("pan_columns", 1, MAX_SIDE)];
  const [viewRows, viewColumns] = [from.u16("view_rows", 1, MAX_VIEWS), from.u16("view_columns", 1, MAX_VIEWS)];
  return { pinStep, west, north, panRows, panColumns, viewRows, viewColumns, first };
}

/** Expand a view; throws a `Fault` if its bytes are none. */
export async function readView(map: TactileMap, index: number): Promise<View> {
  const count = map.rows * map.columns;
  const from = new Fields(await expanded(map.views[index]!, 2 * count + MAX_SYMBOLS_BYTES));
  const symbols = from.list("symbols", from.u16("symbols", 0, 4096), () => symbolOf(from, map));
  if (from.left !== 2 * count) throw corrupt(`view ${index} has ${from.left} bytes of pins`);
  const bytes = from.octets("pins", 0, from.left);
  const pins = Uint16Array.from({ length: count }, (_, n) => bytes[2 * n]! | (bytes[2 * n + 1]! << 8));
  if (pins.some((pin) => (pin & ~UP) > symbols.length)) throw corrupt(`a pin of view ${index} has a symbol that is not there`);
  return { symbols, pins };
}

function symbolOf(from: Fields, { names, kinds }: TactileMap): MapSymbol {
  const role = ROLES[from.u8("role", 0, 3)]!;
  const kind = kinds[from.u16("class", 0, kinds.length - 1)]!;
  const own = from.list("names", from.u16("names", 0, 64), () => names[from.u32("name", 0, names.length - 1)]!);
  from.text("text", 512);
  from.octets("cells", 64);
  if (role === "label" && !own.length) throw corrupt("a label that names nothing");
  return { role, kind, names: own };
}

/** Expand a zlib stream of at most `limit` bytes, without more memory than that and a piece. */
async function expanded(data: Uint8Array<ArrayBuffer>, limit: number): Promise<Uint8Array<ArrayBuffer>> {
  const out = new Uint8Array(limit);
  const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  let size = 0;
  try {
    for (let piece = await stream.read(); !piece.done; piece = await stream.read()) {
      if (size + piece.value.length > limit) throw corrupt("a view that is too long");
      out.set(piece.value, size);
      size += piece.value.length;
    }
  } catch (error) {
    void stream.cancel().catch(() => undefined);
    throw error instanceof Fault ? error : corrupt("a view that does not expand");
  }
  return out.subarray(0, size);
}
