// Drawing capabilities of the device.

export interface Device {
  /** `software`: there is no graphics processor. */
  strength: "software" | "ordinary" | "strong";
  /** True if the user prefers small downloads. */
  saveData: boolean;
}

let known: Device | undefined;

/** Inspects the device once; undefined without WebGL2. */
export function device(): Device | undefined {
  return (known ??= inspect());
}

function inspect(): Device | undefined {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return undefined;
  // Chromium reports the name only through the extension.
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  const browser = navigator as Navigator & { deviceMemory?: number; connection?: { saveData?: boolean } };
  const software = /swiftshader|llvmpipe|software|basic render/i.test(name);
  // Browsers that hide the amount of memory count as ordinary.
  const strong = (browser.deviceMemory ?? 0) >= 8 && browser.hardwareConcurrency >= 8 && !matchMedia("(pointer: coarse)").matches;
  return { strength: software ? "software" : strong ? "strong" : "ordinary", saveData: browser.connection?.saveData ?? false };
}
