// Braille displays over WebHID, with the reports of the HID standard for them (usage page 0x41, HUTRR78 of the USB Implementers
// Forum): a byte a cell, and bit n - 1 of it is dot n. The page draws heights or forces along a line as bars of dots.
const CELLS = [0x410003, 0x410004]; // of eight and of six dots
/** Bits of the dots of a cell, from its lowest row up, left and right. */
const DOTS: Record<number, [number, number][]> = { 8: [[6, 7], [2, 5], [1, 4], [0, 3]], 6: [[2, 5], [1, 4], [0, 3]] };

interface Item {
  usages?: number[];
  usageMinimum?: number;
  usageMaximum?: number;
  isRange?: boolean;
  reportSize?: number;
  reportCount?: number;
}
interface Report {
  reportId: number;
  items?: Item[];
}
interface Collection {
  usagePage?: number;
  outputReports?: Report[];
  children?: Collection[];
}
interface Device extends EventTarget {
  productName: string;
  opened: boolean;
  collections: Collection[];
  open(): Promise<void>;
  close(): Promise<void>;
  sendReport(reportId: number, data: Uint8Array<ArrayBuffer>): Promise<void>;
}
interface Hid extends EventTarget {
  requestDevice(options: { filters: { usagePage: number }[] }): Promise<Device[]>;
}

/** WebHID, where this browser has it and this frame may use it. */
function hidOf(): Hid | undefined {
  const { featurePolicy } = document as unknown as { featurePolicy?: { allowsFeature(name: string): boolean } };
  return featurePolicy?.allowsFeature("hid") === false ? undefined : (navigator as unknown as { hid?: Hid }).hid;
}

/** A row of cells within a report of so many bytes. */
interface Row {
  reportId: number;
  bytes: number;
  start: number;
  cells: number;
  dots: number;
}

/** The rows of cells that a device declares, in the order of its reports. */
function rowsOf(collections: Collection[]): Row[] {
  const rows: Row[] = [];
  const seen = new Set<number>();
  const visit = (collection: Collection): void => {
    for (const { reportId, items = [] } of collection.outputReports ?? []) {
      if (seen.has(reportId)) continue; // a collection lists what those within it list
      seen.add(reportId);
      rows.push(...rowsOfReport(reportId, items));
    }
    for (const child of collection.children ?? []) visit(child);
  };
  for (const collection of collections) visit(collection);
  return rows;
}

function rowsOfReport(reportId: number, items: Item[]): Row[] {
  let bits = 0;
  const rows: Row[] = [];
  for (const { usages = [], usageMinimum, isRange, reportSize = 0, reportCount = 0 } of items) {
    const usage = CELLS.indexOf((isRange ? usageMinimum : usages[0]) ?? 0);
    if (usage >= 0 && reportSize === 8 && bits % 8 === 0) rows.push({ reportId, bytes: 0, start: bits / 8, cells: reportCount, dots: usage ? 6 : 8 });
    bits += reportSize * reportCount;
  }
  return rows.map((row) => ({ ...row, bytes: Math.ceil(bits / 8) }));
}

export class BrailleDisplay {
  private device: Device | null = null;
  private rows: Row[] = [];
  private isBusy = false;
  private waiting: number[] | null = null;
  private sent = "";

  /** `report` gets what happened to the connection, in words. */
  constructor(private readonly report: (text: string) => void) {}

  static get isSupported(): boolean {
    return hidOf() !== undefined;
  }

  get isOpen(): boolean {
    return this.device !== null;
  }

  /** Columns of dots of a line. */
  get columns(): number {
    return 2 * Math.min(...this.rows.map((row) => row.cells));
  }

  /** Ask for a device, and open it. */
  async connect(): Promise<void> {
    try {
      const [device] = await hidOf()!.requestDevice({ filters: [{ usagePage: 0x41 }] });
      if (!device) return this.report("No Braille display was chosen.");
      const rows = rowsOf(device.collections).filter((row) => row.cells > 0);
      if (!rows.length) return this.report(`${device.productName} declares no Braille cells of eight or six dots (usages 3 and 4 of page 0x41).`);
      if (!device.opened) await device.open();
      [this.device, this.rows, this.sent] = [device, rows, ""];
      hidOf()!.addEventListener("disconnect", this.onDisconnect);
      this.report(`${device.productName}: ${rows.length} ${rows.length > 1 ? "rows" : "row"} of ${this.columns / 2} cells.`);
    } catch (error) {
      this.lose(`cannot be opened (${(error as Error).message}); a screen reader may be using it`);
    }
  }

  /** Lower all dots, and close the device. */
  async close(): Promise<void> {
    const { device } = this;
    if (!device) return;
    this.device = null;
    await this.write(device, new Array<number>(this.columns).fill(0)).catch(() => undefined);
    await device.close().catch(() => undefined);
    this.report(`${device.productName} is closed.`);
  }

  /** Show bars from the left to the right, fractions of the display's height. */
  async show(bars: number[]): Promise<void> {
    this.waiting = bars;
    if (this.isBusy) return;
    this.isBusy = true;
    while (this.waiting && this.device) {
      const next: number[] = this.waiting;
      this.waiting = null;
      try {
        await this.write(this.device, next);
      } catch (error) {
        this.lose(`does not answer (${(error as Error).message})`);
      }
    }
    this.isBusy = false;
  }

  private readonly onDisconnect = (event: Event & { device?: Device }): void => {
    if (this.device && event.device === this.device) this.lose("is disconnected");
  };

  private lose(what: string): void {
    const name = this.device?.productName ?? "The Braille display";
    this.device = null;
    this.report(`${name} ${what}.`);
  }

  private async write(device: Device, bars: number[]): Promise<void> {
    const reports = this.reports(bars);
    const text = [...reports].join(";");
    if (text === this.sent) return;
    for (const [id, data] of reports) await device.sendReport(id, data);
    this.sent = text;
  }

  /** The reports that show bars; the rows of cells stand above each other. */
  private reports(bars: number[]): Map<number, Uint8Array<ArrayBuffer>> {
    const reports = new Map<number, Uint8Array<ArrayBuffer>>();
    const levels = this.rows.reduce((sum, row) => sum + row.dots / 2, 0);
    let below = levels;
    for (const row of this.rows) {
      below -= row.dots / 2;
      const data = reports.get(row.reportId) ?? new Uint8Array(row.bytes);
      reports.set(row.reportId, data);
      for (let n = 0; n < row.cells; n++)
        for (const [level, dots] of DOTS[row.dots]!.entries())
          for (const [side, bit] of dots.entries()) if (Math.round(levels * (bars[2 * n + side] ?? 0)) > below + level) data[row.start + n]! |= 1 << bit;
    }
    return reports;
  }
}
