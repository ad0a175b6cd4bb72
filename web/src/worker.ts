// Runs the decoder (engine.ts), or the hand (hand.ts), in a thread of its own, so that the page stays responsive.
// In a page that may have no threads it is a script of the page, which calls the decoder itself.
import { answer, type EngineRequest } from "./engine";
import { HandWorker, type HandOrder } from "./hand";

const hand = new HandWorker((report) => postMessage(report));

if ("document" in globalThis) Object.assign(globalThis, { touchfieldAnswer: answer });
else
  onmessage = ({ data }: MessageEvent<{ id: number; request: EngineRequest } | { hand: HandOrder }>): void => {
    if ("hand" in data) hand.take(data.hand);
    else postMessage({ id: data.id, answer: answer(data.request) });
  };
