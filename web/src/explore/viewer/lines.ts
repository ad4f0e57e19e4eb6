// Lines whose number changes.
import type { ColorRepresentation, Plane } from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";
import { Segments } from "./outline.ts";

export interface LineStyle {
  color: ColorRepresentation;
  /** Pixels of the page; with `inScene`, millimetres. */
  width: number;
  inScene?: boolean;
  /** Drawn over everything else. */
  over?: boolean;
}

export class Lines {
  readonly segments = new Segments();
  readonly object: LineSegments2;
  readonly #material: LineMaterial;
  #stored: Float32Array | undefined;

  constructor({ color, width, inScene = false, over = false }: LineStyle) {
    this.#material = new LineMaterial({ color, linewidth: width, worldUnits: inScene, depthTest: !over, depthWrite: !over, transparent: over });
    this.object = new LineSegments2(new LineSegmentsGeometry(), this.#material);
    this.object.frustumCulled = false;
    this.object.renderOrder = over ? 10 : 3;
    this.object.visible = false;
  }

  /** Shows what `segments` holds now. */
  update(clippingPlanes: Plane[] = []): void {
    const { points, count } = this.segments;
    this.object.visible = count > 0;
    this.#material.clippingPlanes = clippingPlanes;
    if (count === 0) return;
    const geometry = this.object.geometry;
    if (points !== this.#stored) {
      // The old buffer on the device is too small.
      geometry.dispose();
      geometry.setPositions(points);
      this.#stored = points;
    }
    geometry.attributes["instanceStart"]!.needsUpdate = true;
    geometry.instanceCount = count;
  }

  set color(color: ColorRepresentation) {
    this.#material.color.set(color);
  }

  hide(): void {
    this.object.visible = false;
  }

  dispose(): void {
    this.object.geometry.dispose();
    this.#material.dispose();
  }
}
