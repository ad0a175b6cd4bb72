// What the page needs of three.js: basic and Lambert materials to the screen, coloured by their vertices. Modules for what it has
// not (textures, shadows, environments, XR, effects, other materials) are replaced by what their callers find when there is none.
import { readFileSync } from "node:fs";
import { basename, join } from "node:path";

const NONE = {
  "WebXRManager.js": "export class WebXRManager { enabled = false; isPresenting = false; addEventListener() {} removeEventListener() {} dispose() {} setAnimationLoop() {} getEnvironmentBlendMode() {} }",
  "WebGLShadowMap.js": "export class WebGLShadowMap { enabled = false; render() {} }",
  "WebGLEnvironments.js": "export class WebGLEnvironments { get() { return null; } dispose() {} }",
  "WebGLMorphtargets.js": "export class WebGLMorphtargets {}",
  "WebGLOutput.js": "export class WebGLOutput {}",
  "WebGLUniformsGroups.js": "export class WebGLUniformsGroups { dispose() {} }",
  "FrustumArray.js": "export class FrustumArray {}",
  "PMREMGenerator.js": "export class PMREMGenerator {}",
  "Ray.js": "export class Ray {}",
  "WebGLTextures.js": "export class WebGLTextures { resetTextureUnits() {} getTextureUnits() {} setTextureUnits() {} dispose() {} }",
  "WebGLUtils.js": "export class WebGLUtils {}",
  "TextureUtils.js": "export const TextureUtils = {}, getByteLength = () => 0;",
  "WebGLRenderTarget.js": "export class WebGLRenderTarget {}",
  "Texture.js": "export class Texture {}",
  "DataTexture.js": "export class DataTexture {}",
  "DataArrayTexture.js": "export class DataArrayTexture {}",
  "Data3DTexture.js": "export class Data3DTexture {}",
  "CubeTexture.js": "export class CubeTexture {}",
  "DepthTexture.js": "export class DepthTexture {}",
  "DirectionalLightShadow.js": "export class DirectionalLightShadow { dispose() {} }",
  "DFGLUTData.js": "export const getDFGLUT = () => null;",
};

/** Pieces of shader for what no material of the page has: they stand behind an #ifdef that never holds. */
const UNUSED = /^uv_|^map_|batching|morph|skin|shadow|fog|envmap|alphahash|alphamap|alphatest|aomap|lightmap|bumpmap|displacementmap|emissivemap|lightprobe|iridescence|transmission|physical|toon|phong|tonemapping|dithering|clearcoat|packing|cube_uv|logdepthbuf|roughness|metalness|gradientmap|normal_fragment_maps|normalmap_pars|lights_fragment_maps/;
const SHADERS = /^(meshbasic|meshlambert)\.glsl\.js$/;

const plain = (code) => code.replaceAll(/\/\*[^*]*\*\/|\/\/.*$/gm, "").replaceAll(/^[ \t]+|[ \t]+$/gm, "").replaceAll(/\n{2,}/g, "\n");

function made(path) {
  const name = basename(path);
  const code = readFileSync(path, "utf8");
  if (name === "ShaderLib.js") {
    const kept = code.replace(/\n\tphong: \{[\s\S]*$/, "\n};\nexport { ShaderLib };\n");
    if (kept === code) throw new Error(`${path} has changed: see three_core.mjs`);
    return kept;
  }
  if (/\/ShaderLib\//.test(path)) return SHADERS.test(name) ? plain(code) : 'export const vertex = "", fragment = "";';
  return UNUSED.test(name) ? 'export default "";' : plain(code);
}

/** For esbuild. */
export const threeCore = {
  name: "three-core",
  setup(build) {
    const three = join(build.initialOptions.absWorkingDir, "node_modules/three/src");
    build.onResolve({ filter: /^three$/ }, () => ({ path: join(three, "Three.js"), sideEffects: false }));
    build.onLoad({ filter: /three\/src\/renderers\/shaders\/(ShaderLib\.js|.*\.glsl\.js)$/ }, ({ path }) => ({ contents: made(path) }));
    build.onLoad({ filter: new RegExp(`three/src/(?:.*/)?(${Object.keys(NONE).join("|").replaceAll(".", "\\.")})$`) }, ({ path }) => ({ contents: NONE[basename(path)] }));
  },
};
