// Looks of cross sections, and their pictures.
import type { Slide, SlideOptions } from "oviduct-client";

export const LOOKS = ["contours", "stained", "labels"] as const;
/** Look of a cross section. */
export type Look = (typeof LOOKS)[number];

/** Tissues of a label image, from the value 2; the colours are those of the legend. */
export const TISSUES = [
  { name: "Epithelium", color: "#6d3a8c" },
  { name: "Lamina propria", color: "#f0b6c6" },
  { name: "Circular muscle", color: "#c5543f" },
  { name: "Longitudinal muscle", color: "#e59a4c" },
  { name: "Serosa", color: "#5f93ad" },
  { name: "Subserosa", color: "#a9c7d3" },
  { name: "Inner longitudinal muscle", color: "#e0c04c" },
  { name: "Vessel", color: "#a3122b" },
] as const;

/** A picture over a cross section, micrometres. */
export interface Picture {
  url: string;
  width: number;
  height: number;
}

export async function pictureOf(slide: Slide, look: Exclude<Look, "contours">): Promise<Picture> {
  const blob = new Blob([slide.png], { type: "image/png" });
  const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none" });
  const [width, height] = [bitmap.width * slide.um_per_pixel, bitmap.height * slide.um_per_pixel];
  const url = URL.createObjectURL(look === "labels" ? await coloured(bitmap) : blob);
  bitmap.close();
  return { url, width, height };
}

/** Colours tissue labels and makes other pixels transparent. */
async function coloured(labels: ImageBitmap): Promise<Blob> {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [labels.width, labels.height];
  const context = canvas.getContext("2d")!;
  context.drawImage(labels, 0, 0);
  const image = context.getImageData(0, 0, canvas.width, canvas.height);
  colour(image.data);
  context.putImageData(image, 0, 0);
  return new Promise((resolve, reject) => canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("The picture could not be made."))), "image/png"));
}

/** Replaces grey labels by colours, in RGBA pixels. */
export function colour(pixels: Uint8ClampedArray): void {
  const colours = TISSUES.map(({ color }) => [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16)));
  for (let i = 0; i < pixels.length; i += 4) {
    const rgb = colours[pixels[i]! - 2];
    if (rgb) pixels.set(rgb, i);
    else pixels[i + 3] = 0;
  }
}

/** Options of the request for a picture. */
export function slideOptions(look: Exclude<Look, "contours">, size: number): SlideOptions {
  return look === "labels" ? { size, labels: true } : { size, stain: "he" };
}

/**
 * Longest side of a picture for this number of pixels. There are few sizes, so pictures can be
 * reused.
 */
export function sizeFor(pixels: number): number {
  return pixels <= 1100 ? 1024 : 2048;
}
