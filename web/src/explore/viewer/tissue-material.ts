// Shading of walls and caps, with little work per pixel because some browsers draw in software.
import { Color, LinearSRGBColorSpace, ShaderMaterial, Vector3, type ColorRepresentation } from "three";
import { BENT } from "./clipping.ts";
import { LUMEN_DARK } from "./dark.ts";

/** Distances between which the lumen fades into the dark during the flight, millimetres. */
export const FLIGHT_FOG = [0.02, 1.8] as const;
/** Distance at which the lamp of the flight has half of its brightness, millimetres. */
const LAMP_REACH = 0.4;

/** Irradiance from a colour of light, for diffuse surfaces. */
function light(color: ColorRepresentation, intensity: number): Color {
  return new Color(color).multiplyScalar(intensity / Math.PI);
}

/**
 * A lamp above and left of the camera, in camera coordinates, and soft light from sky and ground.
 *
 * In the flight, the lamp is at the camera and its light decreases with the distance.
 */
const SHARED = {
  toLamp: { value: new Vector3(-0.5, 0.8, 1.7).normalize() },
  lamp: { value: light(0xfff4ec, 2.1) },
  sky: { value: light(0xfff6f2, 1.35).add(light(0xffffff, 0.25)) },
  ground: { value: light(0x8a4a5c, 1.35).add(light(0xffffff, 0.25)) },
  dark: { value: displayed(LUMEN_DARK) },
};

// Both cosines are linear in the normal, so they are interpolated instead of the normal.
const VERTEX = /* glsl */ `
#include <clipping_planes_pars_vertex>
uniform vec3 toLamp;
varying vec2 cosines;
#ifdef OCCLUDED
  attribute float openness;
  varying float open;
#endif
#ifdef FLIGHT
  varying float along;
  varying vec3 seen;
#endif
void main() {
  vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
  gl_Position = projectionMatrix * mvPosition;
  #include <clipping_planes_vertex>
  cosines = vec2(dot(normalMatrix * normal, toLamp), normal.y);
  #ifdef OCCLUDED
    open = openness;
  #endif
  #ifdef FLIGHT
    #ifdef BENT
      along = straight.z;
    #else
      along = position.z;
    #endif
    seen = mvPosition.xyz;
    cosines.x = dot(normalize(normalMatrix * normal), -normalize(seen));
  #endif
}`;

// There is a ring every 0.1 mm and a stronger one every millimetre; rings fade where they would be
// dense. Square roots approximate the sRGB curve within 0.003.
const FRAGMENT = /* glsl */ `
#include <clipping_planes_pars_fragment>
uniform vec3 color;
uniform float opacity;
uniform vec3 lamp;
uniform vec3 sky;
uniform vec3 ground;
#ifdef CUT_OPEN
  uniform vec3 cuts[2];
#endif
uniform vec3 dark;
varying vec2 cosines;
#ifdef OCCLUDED
  varying float open;
#endif
#ifdef FLIGHT
  varying float along;
  varying vec3 seen;
  float ring(float spacing, float width) {
    float blur = fwidth(along);
    float distance = abs(fract(along / spacing + 0.5) - 0.5) * spacing;
    return (1.0 - smoothstep(width - blur, width + blur, distance)) * clamp(1.0 - 4.0 * blur / spacing, 0.0, 1.0);
  }
#endif
vec3 displayed(vec3 linear) {
  vec3 root = sqrt(linear);
  vec3 fourth = sqrt(root);
  return clamp(0.585122381 * root + 0.783140355 * fourth - 0.368262736 * sqrt(fourth), 0.0, 1.0);
}
void main() {
  #include <clipping_planes_fragment>
  #ifdef FLAT
    vec3 shown = color;
  #else
    vec2 facing = cosines;
    #if defined(DOUBLE_SIDED) && !defined(CUT_OPEN)
      if (!gl_FrontFacing) facing = -facing;
    #endif
    vec3 scattered = color;
    #ifdef OCCLUDED
      #ifdef FLIGHT
        // In a cleft, the lamp of the flight lights walls that the sky does not reach.
        scattered *= mix(open, 1.0, 0.6);
      #else
        scattered *= open;
      #endif
      #ifdef FLIGHT
        scattered *= 1.0 - max(0.28 * ring(0.1, 0.0012), 0.6 * ring(1.0, 0.004));
      #endif
    #endif
    vec3 soft = mix(ground, sky, 0.5 * facing.y + 0.5);
    #ifdef FLIGHT
      float steps = length(seen) / ${LAMP_REACH.toFixed(2)};
      vec3 near = lamp * (0.5 + 1.6 * max(facing.x, 0.0)) + 0.5 * soft;
      vec3 shown = displayed(scattered * near / (1.0 + steps * steps));
    #else
      vec3 shown = displayed(scattered * (lamp * max(facing.x, 0.0) + soft));
    #endif
  #endif
  #if defined(CUT_OPEN) && NUM_CLIPPING_PLANES > 0
    if (!gl_FrontFacing) {
      shown = cuts[0];
      #if NUM_CLIPPING_PLANES > 1
        // The line of sight enters what is kept through the plane that it meets last, if it comes from behind it.
        vec2 away = vec2(clippingPlanes[0].w, clippingPlanes[1].w);
        vec2 entry = min(away, 0.0) / vec2(dot(vClipPosition, clippingPlanes[0].xyz), dot(vClipPosition, clippingPlanes[1].xyz));
        if (entry.y > entry.x) shown = cuts[1];
      #endif
    }
  #endif
  #ifdef FLIGHT
    shown = mix(shown, dark, smoothstep(${FLIGHT_FOG[0].toFixed(2)}, ${FLIGHT_FOG[1].toFixed(2)}, length(seen)));
  #endif
  gl_FragColor = vec4(shown, opacity);
}`;

/** `lit` surfaces scatter light; other surfaces have a constant colour. */
export class TissueMaterial extends ShaderMaterial {
  constructor(color: number, { lit, occluded, bent }: { lit: boolean; occluded: boolean; bent: boolean }) {
    super({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      clipping: true,
      defines: { ...(occluded && { OCCLUDED: "" }), ...(!lit && { FLAT: "" }), ...(bent && BENT) },
      uniforms: {
        ...SHARED,
        color: { value: lit ? new Color(color) : displayed(color) },
        opacity: { value: 1 },
        cuts: { value: [new Color(), new Color()] },
      },
    });
  }

  /** Shows rings that mark the distance, and the dark ahead. */
  set flight(on: boolean) {
    this.#define("FLIGHT", on);
  }

  /**
   * Colours of back faces. In a closed body that is cut open, back faces are visible through the
   * cuts, as their faces.
   */
  set cuts(colors: readonly number[] | undefined) {
    this.#define("CUT_OPEN", colors !== undefined);
    colors?.forEach((color, k) => (this.uniforms["cuts"]!.value as Color[])[k]!.copy(displayed(color)));
  }

  set glass(opacity: number) {
    this.transparent = opacity < 1;
    this.depthWrite = opacity === 1;
    this.uniforms["opacity"]!.value = opacity;
  }

  #define(name: string, on: boolean): void {
    if (on === name in this.defines) return;
    if (on) this.defines[name] = "";
    else delete this.defines[name];
    this.needsUpdate = true;
  }
}

/** A colour as the display receives it. */
function displayed(color: number): Color {
  return new Color().setHex(color, LinearSRGBColorSpace);
}
