// Reads the records of a `.touch` file (head, provenance, index) for the side panel of the page. The C code
// of touch.h alone decides whether a file is valid.

/** What is wrong with a file, and at which byte, where that is known. */
export class Fault extends Error {
  constructor(readonly kind: string, text: string, readonly byte: number | null) {
    super(text);
  }
}

export interface Records {
  axes: string;
  device: string;
  coder: string;
  tags: string[];
  provenance: [string, string][];
  objects: string[];
  bytes: [string, number][];
  size: number;
}

const OPENING = 14;
const OVERHEAD = 20;
const HEAD_TEXTS = 72;
const decoder = new TextDecoder();

class Reader {
  constructor(private readonly view: DataView, private at: number) {}

  u8 = (): number => this.view.getUint8(this.skip(1));
  u16 = (): number => this.view.getUint16(this.skip(2), true);
  text = (): string => {
    const size = this.u16();
    return decoder.decode(new Uint8Array(this.view.buffer, this.view.byteOffset + this.skip(size), size));
  };

  skip(bytes: number): number {
    const at = this.at;
    this.at += bytes;
    return at;
  }
}

export interface Row {
  tag: string;
  at: number;
  length: number;
}

export function* rows(data: Uint8Array): Generator<Row> {
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  for (let at = OPENING; at + OVERHEAD <= data.length; ) {
    const length = Number(view.getBigUint64(at + 8, true));
    yield { tag: decoder.decode(data.subarray(at, at + 4)), at, length };
    at += OVERHEAD + length;
  }
}

/** The records of a file, or of its start; `size` is that of the whole file. */
export function readRecords(data: Uint8Array, size = data.length): Records {
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const out: Records = { axes: "", device: "", coder: "", tags: [], provenance: [], objects: [], bytes: [], size };
  const sizes = new Map<string, number>();
  for (const { tag, at, length } of rows(data)) {
    sizes.set(tag, (sizes.get(tag) ?? 0) + length + OVERHEAD);
    const from = new Reader(view, at + 16);
    if (tag === "HEAD") {
      from.skip(HEAD_TEXTS);
      out.axes = from.text();
      out.device = from.text();
      from.skip(1 + 9 * 8);
      for (let left = from.u16(); left > 0; left--) out.tags.push(from.text());
      out.coder = from.text();
    } else if (tag === "PROV") {
      for (let left = from.u16(); left > 0; left--) out.provenance.push([from.text(), from.text()]);
    } else if (tag === "OBJT") out.objects.push(from.text());
  }
  out.bytes = [...sizes];
  return out;
}

/** The payload of PROV for frames of a file: its own entries; those about its coding are named as those of the source. */
export function provenanceOf(provenance: [string, string][], name: string, from: number, count: number): Uint8Array {
  const frames = count > 1 ? `frames ${from} to ${from + count - 1}` : `frame ${from}`;
  const clean = name.replaceAll(/[\0-\x1f\x7f-\x9f]/g, "\ufffd").slice(0, 80);
  const pairs = new Map([["source", `${frames} of ${clean}, saved by the page`]]);
  for (const [key, value] of provenance) {
    const own = key === "source" || key === "spec" ? `source.${key}` : key;
    if (pairs.size < 64 && !(own.startsWith("source.") && own === key)) pairs.set(own, value);
  }
  return provenanceBytes([...pairs]);
}

/** The payload of PROV. */
export function provenanceBytes(pairs: [string, string][]): Uint8Array {
  const encoder = new TextEncoder();
  const out: number[] = [pairs.length & 255, pairs.length >> 8];
  for (const text of pairs.flat()) {
    const bytes = encoder.encode(text);
    out.push(bytes.length & 255, bytes.length >> 8, ...bytes);
  }
  return Uint8Array.from(out);
}

const LAST = 40;

/** The byte at which the index starts, from the end of a file; 0: unknown. */
export function indexOffset(tail: Uint8Array): number {
  if (tail.length < LAST) return 0;
  return Number(new DataView(tail.buffer, tail.byteOffset + tail.length - LAST, LAST).getBigUint64(16, true));
}

/** The byte at which the first segment starts, from an index; 0: unknown. */
export function firstSegment(index: Uint8Array): number {
  if (index.length < OVERHEAD + 30) return 0;
  return Number(new DataView(index.buffer, index.byteOffset, index.length).getBigUint64(26, true));
}

/** A fault with the byte of the first record that does not hold, where one does not. */
export function faultOf(kind: string, text: string, data: Uint8Array | null, where = ""): Fault {
  return new Fault(kind, where ? `${text}, ${where}` : text, data && firstBad(data));
}

function firstBad(data: Uint8Array): number | null {
  if (data.length < OPENING) return data.length;
  try {
    let end = OPENING;
    for (const { tag, at, length } of rows(data)) {
      end = at + OVERHEAD + length;
      if (!/^[A-Z0-9]{4}$/.test(tag)) return at;
      if (end > data.length) return data.length;
      const view = new DataView(data.buffer, data.byteOffset + at, OVERHEAD + length);
      if (crc32(data.subarray(at, at + 16 + length)) !== view.getUint32(16 + length, true)) return at;
    }
    return end === data.length ? null : end;
  } catch {
    return null;
  }
}

/** CRC-32 as PNG and `.touch` files have it. */
export function crc32(bytes: Uint8Array): number {
  let crc = ~0;
  for (const byte of bytes) {
    crc ^= byte;
    for (let k = 0; k < 8; k++) crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
  }
  return ~crc >>> 0;
}
