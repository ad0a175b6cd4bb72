// The decoder, in a thread of its own where that is allowed.
import type { EngineRequest } from "./engine";

type Answer = (request: EngineRequest) => unknown;

/** The script of the workers in the page itself. */
function answerInPage(url: string): Promise<Answer> {
  return new Promise((done, failed) => {
    const script = document.createElement("script");
    script.src = url;
    script.onload = (): void => done((window as unknown as { touchfieldAnswer: Answer }).touchfieldAnswer);
    script.onerror = failed;
    document.head.append(script);
  });
}

/** Sends requests to the decoder, and waits for its answers. */
export class Decoder {
  private worker: Worker | null = null;
  private next = 0;
  private readonly waiting = new Map<number, { request: EngineRequest; done: (value: unknown) => void }>();
  private readonly ready: Promise<unknown>;
  private inPage: Promise<Answer> | null = null;

  constructor(module: Promise<WebAssembly.Module>, private readonly script: string) {
    try {
      this.worker = new Worker(script);
      this.worker.onmessage = ({ data }: MessageEvent<{ id: number; answer: unknown }>): void => {
        this.waiting.get(data.id)?.done(data.answer);
        this.waiting.delete(data.id);
      };
      this.worker.onerror = (): void => { // a page around this one may forbid threads
        this.worker = null;
        for (const { request, done } of this.waiting.values()) done(this.answer(request));
        this.waiting.clear();
      };
    } catch {
      this.worker = null;
    }
    this.ready = module.then((compiled) => this.request({ do: "start", module: compiled }));
    this.ready.catch(() => undefined); // the page reports a module that cannot be compiled; requests fail with the same error
  }

  private async answer(request: EngineRequest): Promise<unknown> {
    this.inPage ??= answerInPage(this.script);
    return (await this.inPage)(request);
  }

  async request<T>(request: EngineRequest): Promise<T> {
    if (request.do !== "start") await this.ready;
    const result = this.worker
      ? await new Promise<unknown>((done) => {
          this.waiting.set(++this.next, { request, done });
          this.worker!.postMessage({ id: this.next, request });
        })
      : await new Promise<unknown>((done) => setTimeout(() => done(this.answer(request)), 0));
    if (result && typeof result === "object" && "fault" in result) throw result;
    return result as T;
  }
}
