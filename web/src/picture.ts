// Reads one picture of depth, a grey PNG in millimetres or an `.npy` file, as metres. A browser's own decoding of pictures
// keeps 8 of 16 bits, so the PNG is decoded here (PNG specification, third edition).
import { crc32, Fault } from "./container";

export interface DepthPicture {
  width: number;
  height: number;
  /** Metres, row by row; 0 where there is no measurement. */
  depth: Float32Array<ArrayBuffer>;
  /** How a depth is stored, for a message. */
  sample: string;
}

export const MAX_SIDE = 4096;
const MIN_SIDE = 2;
const NO_DEPTH = 0xffff; // of 16 bits: by convention of some data sets, elsewhere the end of the scale
const UNITS_PER_M = 1000;
const PNG = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
const NPY = [0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59];
const COLOURS: Record<number, string> = { 0: "grey", 2: "RGB", 3: "a palette", 4: "grey and alpha", 6: "RGB and alpha" };
const PNG_EXPECTED = "the page reads one grey channel of 16 or 8 bits, not interlaced";
const NPY_EXPECTED = "the page reads one array [rows, columns] of uint16 (millimetres), float32 or float64 (metres)";
const NPY_HINT = "Save it with numpy.save, one picture per file";

const fault = (found: string, expected: string, hint: string): Fault => new Fault("depth picture", `${found}; ${expected}. ${hint}`, null);
const damaged = (what: string, found: string): Fault => fault(`a damaged ${what}, ${found}`, "the page reads whole files only", "Copy the file again");
const startsWith = (data: Uint8Array, bytes: number[]): boolean => bytes.every((byte, n) => data[n] === byte);

/** Whether a file is a picture, by its name, or, unless that ends with .touch, by its first bytes. */
export const isPicture = (data: Uint8Array, name: string): boolean =>
  /\.(png|npy)$/i.test(name) || (!/\.touch$/i.test(name) && (startsWith(data, PNG) || startsWith(data, NPY)));

/** Read a picture; a `Fault` states what was found, what is expected and what to do. */
export async function readPicture(data: Uint8Array<ArrayBuffer>, name: string): Promise<DepthPicture> {
  if (startsWith(data, PNG)) return readPng(data);
  if (startsWith(data, NPY)) return readNpy(data);
  throw fault(`a file named ${/\.\w+$/.exec(name)?.[0] ?? name} with other first bytes`, "the page reads PNG and .npy files", "Check the file");
}

function requireSize(width: number, height: number): void {
  if (Math.max(width, height) > MAX_SIDE)
    throw fault(`a picture of ${width} × ${height} pixels`, `the page takes at most ${MAX_SIDE} × ${MAX_SIDE}`, "Take every second pixel, or use touchfield encode");
  if (Math.min(width, height) < MIN_SIDE) throw fault(`a picture of ${width} × ${height} pixels`, `a surface needs ${MIN_SIDE} × ${MIN_SIDE}`, "Check the file");
}

/** Metres of stored values; what is not finite or not above 0 is no measurement. */
function metresOf(count: number, valueAt: (n: number) => number, unitsPerM: number): Float32Array<ArrayBuffer> {
  const out = new Float32Array(count);
  for (let n = 0; n < count; n++) {
    out[n] = valueAt(n) / unitsPerM;
    if (!(out[n]! > 0 && out[n]! < Infinity)) out[n] = 0;
  }
  return out;
}

// -- PNG ----------------------------------------------------------------------------------------------------------------

interface PngHeader {
  width: number;
  height: number;
  bytes: number;
}

async function readPng(data: Uint8Array<ArrayBuffer>): Promise<DepthPicture> {
  const { width, height, bytes } = pngHeader(data);
  const stride = width * bytes;
  const rows = await inflated(pngData(data), height * (stride + 1));
  unfilter(rows, stride, height, bytes);
  const depth = metresOf(width * height, (n) => {
    const at = (Math.floor(n / width) * (stride + 1)) + 1 + (n % width) * bytes;
    if (bytes === 1) return rows[at]!;
    const value = 256 * rows[at]! + rows[at + 1]!;
    return value === NO_DEPTH ? 0 : value;
  }, UNITS_PER_M);
  return { width, height, depth, sample: `${8 * bytes} bits, millimetres` };
}

function pngHeader(data: Uint8Array): PngHeader {
  if (data.length < 33) throw damaged("PNG", `cut after ${data.length} bytes`);
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  if (view.getUint32(8) !== 13 || view.getUint32(12) !== 0x49484452) throw damaged("PNG", "without its head (IHDR)");
  if (crc32(data.subarray(12, 29)) !== view.getUint32(29)) throw damaged("PNG", "whose head (IHDR) has another CRC-32");
  const [width, height] = [view.getUint32(16), view.getUint32(20)];
  const [bits, colour, interlaced] = [data[24]!, data[25]!, data[28]!];
  if (colour !== 0 || (bits !== 8 && bits !== 16) || interlaced || data[26] || data[27])
    throw fault(`a PNG of ${COLOURS[colour] ?? "unknown colours"}, ${bits} bits${interlaced ? ", interlaced" : ""}`, PNG_EXPECTED, "Save the depth itself, not a coloured picture of it");
  requireSize(width, height);
  return { width, height, bytes: bits / 8 };
}

/** The compressed data of all IDAT chunks. */
function pngData(data: Uint8Array<ArrayBuffer>): Uint8Array<ArrayBuffer>[] {
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const parts: Uint8Array<ArrayBuffer>[] = [];
  for (let at = 8; ; ) {
    if (at + 12 > data.length) throw damaged("PNG", "without its end (IEND)");
    const [length, tag] = [view.getUint32(at), view.getUint32(at + 4)];
    if (at + 12 + length > data.length) throw damaged("PNG", `cut within the chunk at byte ${at}`);
    if (tag === 0x49444154) parts.push(data.subarray(at + 8, at + 8 + length));
    if (tag === 0x49454e44) return parts;
    at += 12 + length;
  }
}

/** Inflate to exactly `size` bytes; no more than that is stored of what a damaged file inflates to. */
async function inflated(parts: Uint8Array<ArrayBuffer>[], size: number): Promise<Uint8Array> {
  const out = new Uint8Array(size);
  const stream = new Blob(parts).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  let at = 0;
  try {
    for (let part = await stream.read(); !part.done; part = await stream.read()) {
      if (at + part.value.length > size) throw null;
      out.set(part.value, at);
      at += part.value.length;
    }
  } catch {
    void stream.cancel().catch(() => undefined);
    throw damaged("PNG", `whose pixels do not inflate to ${size} bytes`);
  }
  if (at < size) throw damaged("PNG", `whose pixels inflate to ${at} of ${size} bytes`);
  return out;
}

/** Undo the filters of all rows in place; a row is its filter and `stride` bytes. */
function unfilter(rows: Uint8Array, stride: number, height: number, step: number): void {
  const above = new Uint8Array(stride + step);
  for (let y = 0; y < height; y++) {
    const row = rows.subarray(y * (stride + 1), (y + 1) * (stride + 1));
    const filter = row[0]!;
    if (filter > 4) throw damaged("PNG", `with the unknown filter ${filter} in row ${y}`);
    for (let x = 0; x < stride; x++) {
      const [left, up, corner] = [x < step ? 0 : row[x + 1 - step]!, above[x + step]!, above[x]!];
      row[x + 1]! += filter === 1 ? left : filter === 2 ? up : filter === 3 ? (left + up) >> 1 : filter === 4 ? paeth(left, up, corner) : 0;
    }
    above.set(row.subarray(1), step);
  }
}

function paeth(left: number, up: number, corner: number): number {
  const [a, b, c] = [Math.abs(up - corner), Math.abs(left - corner), Math.abs(left + up - 2 * corner)];
  return a <= b && a <= c ? left : b <= c ? up : corner;
}

// -- NPY ----------------------------------------------------------------------------------------------------------------

function readNpy(data: Uint8Array<ArrayBuffer>): DepthPicture {
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const isLong = (data[6] ?? 0) > 1;
  const start = isLong ? 12 : 10;
  if (data.length < start) throw damaged(".npy file", `cut after ${data.length} bytes`);
  const from = start + (isLong ? view.getUint32(8, true) : view.getUint16(8, true));
  if (from > data.length) throw damaged(".npy file", "cut within its head");
  const head = new TextDecoder("latin1").decode(data.subarray(start, from));
  const [, order, type] = /'descr': *'([<>|=]?)(\w+)'/.exec(head) ?? [];
  const shape = /'shape': *\(([\d, ]*)\)/.exec(head)?.[1]?.split(",").filter((n) => n.trim()).map(Number);
  const isByColumns = /'fortran_order': *(True|False)/.exec(head)?.[1];
  if (!shape || !isByColumns) throw damaged(".npy file", "whose head is not readable");
  if (!type || !/^(u2|f4|f8)$/.test(type) || shape.length !== 2)
    throw fault(`an .npy file of ${type ? `type ${type}` : "records"}, shape (${shape.join(", ")})`, NPY_EXPECTED, NPY_HINT);
  const [height, width] = shape as [number, number];
  requireSize(width, height);
  const bytes = Number(type[1]);
  if (data.length < from + height * width * bytes) throw damaged(".npy file", `of ${data.length} bytes where ${from + height * width * bytes} are due`);
  const isLittle = order !== ">";
  const stored = (at: number): number => {
    if (type === "u2") return view.getUint16(at, isLittle) % NO_DEPTH;
    return type === "f4" ? view.getFloat32(at, isLittle) : view.getFloat64(at, isLittle);
  };
  const indexOf = (n: number): number => (isByColumns === "True" ? (n % width) * height + Math.floor(n / width) : n);
  const depth = metresOf(width * height, (n) => stored(from + bytes * indexOf(n)), type === "u2" ? UNITS_PER_M : 1);
  return { width, height, depth, sample: type === "u2" ? "uint16, millimetres" : `float${8 * bytes}, metres` };
}
