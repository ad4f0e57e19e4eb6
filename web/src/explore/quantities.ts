// Titles and units of the quantities of a model. A test compares them with
// crates/surface/src/measure/morphometry/quantity.rs.

export interface Quantity {
  title: string;
  /** Empty for a number without a unit. */
  unit: string;
}

const QUANTITIES: Record<string, readonly [title: string, unit: string]> = {
  lumen_area_mm2: ["Lumen area", "mm²"],
  tissue_area_mm2: ["Tissue area", "mm²"],
  tissue_diameter_mm: ["Diameter of the circle of the tissue area", "mm"],
  outer_diameter_mm: ["Outer diameter", "mm"],
  wall_share: ["Wall share", ""],
  fill: ["Fill", ""],
  lumen_perimeter_mm: ["Lumen perimeter", "mm"],
  perimeter_ratio: ["Perimeter ratio", ""],
  hydraulic_diameter_um: ["Hydraulic diameter", "µm"],
  islands: ["Islands", ""],
  folds_on_ring: ["Folds on the ring", ""],
  primary_folds: ["Primary folds", ""],
  secondary_folds: ["Secondary folds", ""],
  tertiary_folds: ["Tertiary folds", ""],
  branching_order: ["Branching order, median", ""],
  branching_order_mean: ["Branching order, mean", ""],
  fold_height_p5_um: ["Fold height, 5th percentile", "µm"],
  fold_height_p50_um: ["Fold height, median", "µm"],
  fold_height_p95_um: ["Fold height, 95th percentile", "µm"],
  fold_height_cv: ["Fold height, coefficient of variation", ""],
  fold_height_share: ["Fold height over half the base ellipse", ""],
  fold_angle_deg: ["Angle of primary folds to the radius, median", "°"],
  asymmetry: ["Asymmetry of the mucosa", ""],
  angular_cv: ["Mucosa by direction, coefficient of variation", ""],
  tissue_thickness_p5_um: ["Tissue thickness, 5th percentile", "µm"],
  tissue_thickness_p50_um: ["Tissue thickness, median", "µm"],
  tissue_thickness_p95_um: ["Tissue thickness, 95th percentile", "µm"],
  tissue_thickness_cv: ["Tissue thickness, coefficient of variation", ""],
  lumen_gap_p5_um: ["Lumen gap, 5th percentile", "µm"],
  lumen_gap_p50_um: ["Lumen gap, median", "µm"],
  lumen_gap_p95_um: ["Lumen gap, 95th percentile", "µm"],
  lumen_gap_cv: ["Lumen gap, coefficient of variation", ""],
  touching_share: ["Mucosa with a gap below 10 µm", ""],
  fractal_dimension: ["Fractal dimension of the lumen area", ""],
  fractal_dimension_error: ["Its standard error", ""],
  outline_dimension: ["Fractal dimension of the lumen outline", ""],
  outline_dimension_error: ["Its standard error", ""],
  lacunarity: ["Lacunarity of the lumen area", ""],
  muscle_thickness_um: ["Muscle thickness", "µm"],
  circular_thickness_um: ["Circular muscle, thickness", "µm"],
  longitudinal_thickness_um: ["Longitudinal muscle, thickness", "µm"],
  inner_longitudinal_thickness_um: ["Inner longitudinal muscle, thickness", "µm"],
  lamina_thickness_um: ["Lamina propria, area over mucosa", "µm"],
  epithelium_height_um: ["Epithelium, area over mucosa", "µm"],
  subserosa_thickness_um: ["Subserosa, thickness", "µm"],
  muscle_area_mm2: ["Muscle area", "mm²"],
  mucosa_area_mm2: ["Mucosa area", "mm²"],
  muscle_over_mucosa: ["Muscle over mucosa, by area", ""],
  lamina_over_epithelium: ["Lamina propria over epithelium, by area", ""],
  longitudinal_cover: ["Circumference with longitudinal muscle", ""],
  vessels: ["Vessels", ""],
  free_lumen: ["Free lumen", ""],
  lumen_disc_share: ["Largest disc in the lumen over the base ellipse", ""],
  cleft_lamina_um: ["Lamina propria below clefts, median", "µm"],
  // Changes from one section or cut to the next.
  fold_splits_per_mm: ["Folds that split", "1/mm"],
  fold_joins_per_mm: ["Folds that join", "1/mm"],
  blind_pockets_per_mm: ["Clefts that end blind", "1/mm"],
  // Quantities of the whole tube, as on the page of the report.
  length_mm: ["Length", "mm"],
  isthmus_length_mm: ["Length of the isthmus", "mm"],
  ampulla_length_mm: ["Length of the ampulla", "mm"],
  fold_ratio: ["Folds, ampulla over isthmus", ""],
};

/** A quantity by its name in reports. Names from a later version are shown unchanged. */
export function quantity(name: string): Quantity {
  const [title, unit] = QUANTITIES[name] ?? [name, ""];
  return { title, unit };
}
