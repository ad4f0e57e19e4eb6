// Clipping by planes. A bent tube is clipped where planes cut the straight tube, so cuts follow its
// course.
import { ShaderChunk } from "three";

// At the edge of a thin triangle, a pixel's centre lies outside the triangle. The position along
// the tube may be far off there.
for (const chunk of ["clipping_planes_pars_vertex", "clipping_planes_pars_fragment"] as const) {
  ShaderChunk[chunk] = ShaderChunk[chunk].replace(/^\s*varying/m, "centroid varying");
}

/**
 * Define for materials whose geometries have the attribute `straight`: positions in the straight
 * tube.
 */
export const BENT = { BENT: "" };

ShaderChunk.clipping_planes_pars_vertex += `
#ifdef BENT
  attribute vec3 straight;
#endif`;
ShaderChunk.clipping_planes_vertex += `
#if defined(BENT) && NUM_CLIPPING_PLANES > 0
  vClipPosition = -(modelViewMatrix * vec4(straight, 1.0)).xyz;
#endif`;
