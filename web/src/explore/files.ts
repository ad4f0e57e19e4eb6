// Contents of a model's files by name (docs/files.md).

const WHOLE: Record<string, string> = {
  "model.lod0.glb": "Surface for browsers, every triangle",
  "model.lod1.glb": "Surface for browsers, medium detail",
  "model.lod2.glb": "Surface for browsers, light",
  "animation.glb": "Contraction, glTF animation for browsers",
  "frames.xdmf": "Contraction, every frame in full, XDMF (ParaView)",
  "frames.bin": "Contraction, the positions that frames.xdmf refers to",
  "centreline.vtp": "Centre line, VTK",
  "centreline.csv": "Centre line, table",
  "labels.ome.tif": "Tissue of every voxel, OME-TIFF",
  "labels.nii.gz": "Tissue of every voxel, NIfTI, compressed",
  "sections.bin": "All cross sections",
  "report.json": "Certificate, measures and spec",
};

const BODIES: Record<string, string> = { model: "Surface", lumen: "Surface of the lumen", regions: "Tissue and lumen with their common wall" };

const FORMATS: Record<string, string> = {
  glb: "glTF binary",
  gltf: "glTF text",
  bin: "data of the glTF text",
  obj: "Wavefront OBJ",
  stl: "STL",
  "ascii.stl": "STL as text",
  ply: "PLY",
  vtp: "VTK",
  "3mf": "3MF",
};

/** Content of a file; undefined for an unknown name. */
export function subjectOf(name: string): string | undefined {
  if (Object.hasOwn(WHOLE, name)) return WHOLE[name];
  const [, body = "", format = ""] = /^([^.]*)\.(.*)$/.exec(name) ?? [];
  return Object.hasOwn(BODIES, body) && Object.hasOwn(FORMATS, format) ? `${BODIES[body]}, ${FORMATS[format]}` : undefined;
}
