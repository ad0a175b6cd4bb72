// Runs the decoder (engine.ts) in a thread of its own, so that the page stays responsive.
import { answer, type EngineRequest } from "./engine";

onmessage = (event: MessageEvent<{ id: number; request: EngineRequest }>): void => {
  postMessage({ id: event.data.id, answer: answer(event.data.request) });
};
