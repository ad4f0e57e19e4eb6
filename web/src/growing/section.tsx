// Drawing of a cross section: tissue between the outer and the inner contour.
import type { Contour } from "../models.ts";
import { micrometres } from "../ui/format.ts";
import { bounds, roundLength, type Bounds } from "./contours.ts";
import "./section.css";

export interface Drawn {
  inner: Contour;
  outer: Contour;
}

interface Props extends Drawn {
  /** Description for users who cannot see the drawing; without it, the drawing is decorative. */
  label?: string;
  /** Box to show; by default the bounding box of the section. */
  box?: Bounds;
  scaleBar?: boolean;
}

export function SectionDrawing({ inner, outer, label, box = bounds([outer]), scaleBar = false }: Props) {
  if (!box) return null;
  const side = Math.max(box.x[1] - box.x[0], box.y[1] - box.y[0]) * 1.06;
  // The y axis points up.
  const [left, top] = [(box.x[0] + box.x[1] - side) / 2, -(box.y[0] + box.y[1] + side) / 2];
  const below = scaleBar ? side * 0.1 : 0;
  return (
    <svg class="section-drawing" viewBox={`${left} ${top} ${side} ${side + below}`} role={label ? "img" : undefined} aria-label={label} aria-hidden={!label}>
      <path class="tissue" d={path(outer) + path(inner)} />
      <path class="mucosa" d={path(inner)} />
      {scaleBar && <ScaleBar left={left} bottom={top + side + below} side={side} />}
    </svg>
  );
}

function ScaleBar({ left, bottom, side }: { left: number; bottom: number; side: number }) {
  const length = roundLength(side * 0.35);
  const [x, y] = [left + side * 0.02, bottom - side * 0.02];
  return (
    <g class="scale-bar">
      <path d={`M${x} ${y - side * 0.03}V${y}H${x + length}V${y - side * 0.03}`} />
      <text x={x + length + side * 0.02} y={y} font-size={side * 0.05}>{micrometres(length)}</text>
    </g>
  );
}

function path(contour: Contour): string {
  let text = "";
  for (let at = 0; at < contour.length; at += 2) {
    text += `${at === 0 ? "M" : "L"}${contour[at]!.toFixed(1)} ${(-contour[at + 1]!).toFixed(1)}`;
  }
  return `${text}Z`;
}
