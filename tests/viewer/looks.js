// What a test asks of an open page, and devices that a page finds: read into the page by test_reach.py.
window.looks = {
  /** Names of the controls that are smaller than 24 pixels. */
  smallTargets: () =>
    [...document.querySelectorAll("button, input, select, summary")]
      .filter((element) => element.checkVisibility())
      .map((element) => [element.id || element.tagName, element.getBoundingClientRect()])
      .filter(([, box]) => box.width < 24 || box.height < 24)
      .map(([name]) => name),

  /** Pairs of parts of the page that lie on each other. */
  overlaps: () => {
    const boxes = ["header", "#view", "#legend", "#caption", "aside", "#time", "#fields"]
      .map((name) => [name, document.querySelector(name)])
      .filter(([, element]) => element.checkVisibility())
      .map(([name, element]) => [name, element.getBoundingClientRect()]);
    const isApart = (a, b) => a.right <= b.left + 1 || b.right <= a.left + 1 || a.bottom <= b.top + 1 || b.bottom <= a.top + 1;
    return boxes.flatMap(([name, box], n) => boxes.slice(n + 1).filter(([, other]) => !isApart(box, other)).map(([other]) => [name, other]));
  },

  /** The luminance of the ground, and the contrasts of texts by WCAG 2. */
  contrasts: () => {
    const style = getComputedStyle(document.documentElement);
    const luminance = (name) => {
      const hex = style.getPropertyValue(name).trim().slice(1);
      const [r, g, b] = [0, 2, 4].map((n) => parseInt(hex.slice(n, n + 2), 16) / 255).map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
      return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const ratio = (a, b) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    const pairs = [["--ink", "--ground"], ["--ink", "--view"], ["--soft", "--panel"], ["--accent", "--panel"], ["--alarmed", "--alarm"]];
    return [luminance("--ground"), ...pairs.map(([a, b]) => ratio(luminance(a), luminance(b)))];
  },

  /** All that the page writes, speaks, and says of its controls. */
  texts: () =>
    [
      ...[...document.querySelectorAll("body, #provenance, #spoken")].map((element) => element.innerText),
      ...[...document.querySelectorAll("input")].map((input) => input.getAttribute("aria-valuetext") ?? input.value),
    ].join("\n"),

  width: () => document.documentElement.scrollWidth,
  shown: () => ["loading", "empty"].map((id) => document.getElementById(id).checkVisibility()),

  /** Plug in a pad with motors in its triggers; its effects are kept. */
  plugPad: () => {
    const pad = { axes: [0, 0, 0, 0], buttons: Array.from({ length: 17 }, () => ({ pressed: false })), effects: [] };
    const playEffect = async (kind, effect) => void pad.effects.push({ kind, at: performance.now(), ...effect });
    pad.vibrationActuator = { effects: ["dual-rumble", "trigger-rumble"], reset: async () => "complete", playEffect };
    Object.defineProperty(navigator, "getGamepads", { value: () => [null, pad] });
    window.pad = pad;
    dispatchEvent(new Event("gamepadconnected"));
  },

  /** A Braille display of a row of twelve cells, whose reports begin with a byte of another usage; they are kept. */
  plugBraille: () => {
    window.reports = [];
    const item = (usage, reportCount) => ({ usages: [usage], reportSize: 8, reportCount });
    const outputReports = [{ reportId: 3, items: [item(0x410007, 1), item(0x410003, 12)] }];
    const row = { usagePage: 0x41, usage: 2, children: [], outputReports };
    const device = Object.assign(new EventTarget(), {
      productName: "Cells of twelve", opened: false, collections: [{ usagePage: 0x41, usage: 1, outputReports, children: [row] }],
      open: async () => void (device.opened = true),
      close: async () => void (device.opened = false),
      sendReport: async (id, data) => void reports.push([id, [...data]]),
    });
    Object.defineProperty(navigator, "hid", { value: Object.assign(new EventTarget(), { requestDevice: async () => [device] }) });
  },
};
0;
