// Runs the decoder (engine.ts) in a thread of its own, so that the page stays responsive.
import { answer, type Ask } from "./engine";

onmessage = (event: MessageEvent<{ id: number; ask: Ask }>): void => {
  postMessage({ id: event.data.id, answer: answer(event.data.ask) });
};
