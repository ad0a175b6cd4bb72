// A file of which only what is played is read: its end with the index, its start, and then the segments that are shown.
import { firstSegment, indexOffset } from "../container";
import type { Opened, Piece } from "../engine";
import { decoder } from "./threads";

/** Bytes of a file, from a position to before another. */
export type Read = (from: number, to: number) => Promise<Uint8Array>;

const MIN_READ_BYTES = 1 << 14;

export class RemoteFile {
  /** Segments that are on their way. */
  private readonly pending = new Map<number, Promise<void>>();

  /** `isOpen` returns whether the decoder still has this file: bytes that come later are dropped. */
  constructor(private readonly read: Read, private readonly isOpen: () => boolean) {}

  /** Open a file of so many bytes; null if another file was opened meanwhile. */
  async open(size: number): Promise<Opened | null> {
    await decoder.request({ do: "room", size });
    const tail = await this.bring(Math.max(0, size - MIN_READ_BYTES), size);
    const index = indexOffset(tail);
    const within = tail.length - (size - index);
    const entries = within < 0 && index > 0 ? await this.bring(index, size) : tail.subarray(Math.max(within, 0));
    const first = firstSegment(entries);
    if (!(first > 0 && first < size)) throw { fault: "cut short", message: "no index at its end", byte: null };
    await this.bring(0, first);
    return this.isOpen() ? decoder.request<Opened>({ do: "open-parts", first }) : null;
  }

  /** Fetch what is shown about a time. */
  async fetch(time: number): Promise<void> {
    if (!this.isOpen()) return;
    for (const { segment, from, to } of await decoder.request<Piece[]>({ do: "missing", time })) {
      if (!this.pending.has(segment)) this.pending.set(segment, this.bring(from, to, segment).then(() => undefined).finally(() => this.pending.delete(segment)));
      await this.pending.get(segment);
    }
  }

  private async bring(from: number, to: number, segment: number | null = null): Promise<Uint8Array> {
    const data = await this.read(from, to);
    if (this.isOpen()) await decoder.request({ do: "bring", at: from, data, segment });
    return data;
  }
}
