// What every page does with its elements: find and fill them, and take the files that it was given or that are dropped on it.

export const byId = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;
export const input = (id: string): HTMLInputElement => byId<HTMLInputElement>(id);
export const setText = (id: string, text: string): void => void (byId(id).textContent = text);
export const setPressed = (id: string, isPressed: boolean): void => byId(id).setAttribute("aria-pressed", String(isPressed));

/** Move a slider by so many of its units, as a user does. */
export function nudge(id: string, by: number): void {
  const slider = input(id);
  slider.value = String(Number(slider.value) + by);
  slider.dispatchEvent(new Event("input"));
}

/** Make an element with values of its properties, attributes and children. */
export function element<K extends keyof HTMLElementTagNameMap>(tag: K, values: Partial<HTMLElementTagNameMap[K]>, attributes: Record<string, string> = {}, ...children: (Node | string)[]): HTMLElementTagNameMap[K] {
  const out = Object.assign(document.createElement(tag), values);
  for (const [name, value] of Object.entries(attributes)) out.setAttribute(name, value);
  out.append(...children);
  return out;
}

/** The bytes of an element whose text is Base64. */
export const bytesOf = (id: string): Uint8Array<ArrayBuffer> => codesOf(atob(byId(id).textContent!.trim()));

/** The same; the element is removed first, so that a movie is not in memory twice. */
export function takeBytes(id: string): Uint8Array<ArrayBuffer> {
  const letters = atob(byId(id).textContent!.trim());
  byId(id).remove();
  return codesOf(letters);
}

function codesOf(letters: string): Uint8Array<ArrayBuffer> {
  const out = new Uint8Array(letters.length);
  for (let n = 0; n < letters.length; n++) out[n] = letters.charCodeAt(n);
  return out;
}

/** Pass on the file that is dropped on the page; `marked` has the class "over" while one is above it. */
export function onFileDrop(marked: HTMLElement, open: (file: File) => void): void {
  for (const name of ["dragover", "dragleave", "drop"] as const) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      marked.classList.toggle("over", name === "dragover");
      const file = name === "drop" ? event.dataTransfer?.files[0] : undefined;
      if (file) open(file);
    });
  }
}
