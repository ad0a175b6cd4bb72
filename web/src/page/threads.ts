// The two threads besides the page, decoder and hand: they run one WebAssembly module, and wait until it is compiled.
import { Decoder } from "../decoder";
import { byId, bytesOf } from "../elements";
import { Hand } from "../hand";

async function compile(): Promise<WebAssembly.Module> {
  const packed = new Blob([bytesOf("decoder")]).stream().pipeThrough(new DecompressionStream("gzip"));
  return WebAssembly.compile(await new Response(packed).arrayBuffer());
}

export const compiled = compile();

const script = URL.createObjectURL(new Blob([byId("worker").textContent!], { type: "text/javascript" }));

export const decoder = new Decoder(compiled, script);
export const hand = new Hand(compiled, script);
