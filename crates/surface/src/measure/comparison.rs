//! Comparison of a model's measures with published ones.
//!
//! The published values are `references/morphometry.csv`, compiled in: one row per value, with its
//! source and the confidence in it. Column `measure` names the quantity of a model that the value
//! can be compared with, and `model_region` the region.

use super::morphometry::{Measures, Morphometry, QUANTITIES, Quantity};
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;

/// Published value.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Reference {
    /// Organ.
    pub organ: String,
    /// Species.
    pub species: String,
    /// Region, as named by the source.
    pub region: String,
    /// Measured quantity, as named by the source.
    pub quantity: String,
    /// Mean, or the only value given.
    pub value: Option<f64>,
    /// Lower end of the range: mean minus standard deviation, if the source reports these.
    pub low: Option<f64>,
    /// Upper end of the range.
    pub high: Option<f64>,
    /// Standard deviation.
    pub sd: Option<f64>,
    /// Number of individuals.
    pub n: Option<u32>,
    /// Unit of these numbers.
    pub unit: String,
    /// Source of the published value.
    pub source: String,
    /// Origin of the value: read in the source, derived from it, or recalled from memory.
    pub confidence: String,
    /// Quantity of a model; empty if models have no such quantity.
    pub measure: String,
    /// Region of the model.
    pub model_region: String,
    /// Factor from the published unit to that of the model.
    pub factor: Option<f64>,
    /// `unknown` if the source does not state what it measured or how, so that a value of a model
    /// may be another measure. The column may be missing at the end of a row.
    #[serde(default)]
    pub method: String,
}

const FILE: &str = include_str!("../../../../references/morphometry.csv");

/// Returns all published values.
#[must_use]
pub fn references() -> &'static [Reference] {
    static REFERENCES: LazyLock<Vec<Reference>> = LazyLock::new(|| {
        let mut rows = csv::ReaderBuilder::new().flexible(true).from_reader(FILE.as_bytes());
        rows.deserialize().collect::<Result<_, _>>().expect("the file is tested to be valid")
    });
    &REFERENCES
}

/// Comparison of a model with values published for its organ and species.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Comparison {
    /// Organ.
    pub organ: String,
    /// Species.
    pub species: String,
    /// Number of measures inside the published range.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub inside: usize,
    /// Number of measures outside the published range.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub outside: usize,
    /// Measures with a published value.
    pub compared: Vec<Compared>,
    /// Quantities without a published value in any region.
    pub no_reference: Vec<String>,
    /// Reason why the tube is shorter than published, if the preset was shortened by choice; null if
    /// no length is too small.
    #[serde(default)]
    pub shortened: Option<String>,
}

/// Result of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Within the published range.
    Inside,
    /// Outside the published range.
    Outside,
    /// A value is published, but no range.
    NoRange,
    /// A value is published, but not how it was measured.
    MethodUnknown,
    /// The model has no such measure, for example because it has no section in the region.
    NotMeasured,
    /// The length is below the published one by choice: the preset is shorter than the organ.
    Shortened,
}

/// A measure and a published value, in the unit of the measure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Compared {
    /// Name of the quantity.
    pub quantity: String,
    /// Region of the model.
    pub region: String,
    /// Mean of the model over the region; null if the model lacks the measure.
    pub measured: Option<f64>,
    /// Published mean, or the only published value.
    pub value: Option<f64>,
    /// Lower end of the published range.
    pub low: Option<f64>,
    /// Upper end of the published range.
    pub high: Option<f64>,
    /// Published standard deviation.
    pub sd: Option<f64>,
    /// Number of individuals in the publication.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub n: Option<u32>,
    /// Result of the comparison.
    pub verdict: Verdict,
    /// Difference from the published mean, in published standard deviations; null if one of these
    /// is missing.
    pub deviation_sd: Option<f64>,
    /// Region and quantity, as the source names them.
    pub published: String,
    /// Source of the published value.
    pub source: String,
    /// Origin of the value: read in the source, derived from it, or recalled from memory.
    pub confidence: String,
}

/// Measures that are too small if a preset is shorter than the organ.
const LENGTHS: [&str; 3] = ["length_mm", "isthmus_length_mm", "ampulla_length_mm"];

/// Compares a model with all published values of an organ and species. `shortened` is the reason
/// why its preset is shorter than the organ.
#[must_use]
pub fn compare(morphometry: &Morphometry, organ: &str, species: &str, shortened: Option<&str>) -> Comparison {
    let own = references().iter().filter(|r| r.organ == organ && r.species == species && !r.measure.is_empty());
    let mean = |reference: &Reference| morphometry.mean(&reference.measure, &reference.model_region);
    let by_choice = |compared: Compared| if shortened.is_some() { compared.shortened() } else { compared };
    let compared: Vec<Compared> = own.map(|reference| by_choice(beside(mean(reference), reference))).collect();
    let count = |verdict| compared.iter().filter(|c| c.verdict == verdict).count();
    let without = |quantity: &&'static Quantity| compared.iter().all(|c| c.quantity != quantity.name);
    Comparison {
        organ: organ.into(),
        species: species.into(),
        inside: count(Verdict::Inside),
        outside: count(Verdict::Outside),
        no_reference: QUANTITIES.iter().filter(without).map(|quantity| quantity.name.into()).collect(),
        shortened: shortened.filter(|_| count(Verdict::Shortened) > 0).map(Into::into),
        compared,
    }
}

impl Compared {
    /// The comparison for a model of a shortened preset: a length below the published one is no
    /// deviation.
    fn shortened(self) -> Self {
        let least = self.low.or(self.value);
        let is_short = LENGTHS.contains(&self.quantity.as_str())
            && self.measured.zip(least).is_some_and(|(measured, least)| measured < least);
        if is_short { Self { verdict: Verdict::Shortened, deviation_sd: None, ..self } } else { self }
    }
}

/// Compares one section with the values published for its organ and species: those of a region and
/// of the whole tube, or those of all regions if the region is not known. Measures of tubes are
/// left out.
#[must_use]
pub fn compare_section(measures: &Measures, organ: &str, species: &str, region: Option<&str>) -> Vec<Compared> {
    let in_region = |own: &str| own == "whole" || region.is_none_or(|region| region == own);
    let of = |r: &&Reference| r.organ == organ && r.species == species && in_region(&r.model_region);
    let with_quantity = |r: &'static Reference| Some((Quantity::named(&r.measure)?, r));
    let pairs = references().iter().filter(of).filter_map(with_quantity);
    pairs.map(|(quantity, reference)| beside(quantity.of(measures), reference)).collect()
}

/// Organs and species for which values of sections are published.
pub fn compared_species() -> impl Iterator<Item = (&'static str, &'static str)> {
    let with_quantity = references().iter().filter(|r| Quantity::named(&r.measure).is_some());
    with_quantity.map(|r| (r.organ.as_str(), r.species.as_str())).collect::<std::collections::BTreeSet<_>>().into_iter()
}

fn beside(measured: Option<f64>, reference: &Reference) -> Compared {
    let factor = reference.factor.unwrap_or(1.0);
    let [value, low, high, sd] =
        [reference.value, reference.low, reference.high, reference.sd].map(|x| x.map(|x| x * factor));
    let verdict = match (measured, low, high) {
        (None, ..) => Verdict::NotMeasured,
        (Some(_), ..) if reference.method == "unknown" => Verdict::MethodUnknown,
        (Some(_), None, None) => Verdict::NoRange,
        (Some(x), low, high) => {
            let inside = low.is_none_or(|low| x >= low) && high.is_none_or(|high| x <= high);
            if inside { Verdict::Inside } else { Verdict::Outside }
        }
    };
    let deviation_sd = match (measured, value, sd) {
        (Some(x), Some(value), Some(sd)) if sd > 0.0 => Some((x - value) / sd),
        _ => None,
    };
    Compared {
        quantity: reference.measure.clone(),
        region: reference.model_region.clone(),
        measured,
        value,
        low,
        high,
        sd,
        n: reference.n,
        verdict,
        deviation_sd,
        published: format!("{}: {}", reference.region, reference.quantity),
        source: reference.source.clone(),
        confidence: reference.confidence.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::morphometry::{Along, Region, Shape, Tube, measure};

    #[test]
    fn every_row_is_consistent() {
        let tube = serde_json::json!(Tube::default());
        for r in references() {
            let numbers = [r.low, r.value, r.high];
            let known: Vec<f64> = numbers.into_iter().flatten().collect();
            assert!(!known.is_empty() && known.is_sorted(), "{r:?}");
            assert!(["", "unknown"].contains(&r.method.as_str()), "{r:?}");
            assert!(!r.source.is_empty() && !r.confidence.is_empty() && !r.unit.is_empty(), "{r:?}");
            if let (Some(sd), Some(value), Some(high)) = (r.sd, r.value, r.high) {
                assert!((value + sd - high).abs() < 0.011, "{r:?}");
            }
            let named = Quantity::named(&r.measure).is_some();
            match r.model_region.as_str() {
                "" => assert!(r.measure.is_empty() && r.factor.is_none(), "{r:?}"),
                "tube" => assert!(tube.get(&r.measure).is_some() && r.factor.is_some(), "{r:?}"),
                "isthmus" | "junction" | "ampulla" | "whole" => assert!(named && r.factor.is_some(), "{r:?}"),
                other => panic!("{other}"),
            }
        }
    }

    #[test]
    fn every_preset_has_something_to_be_compared_with() {
        for preset in oviduct_spec::spec::presets() {
            let found = compare(&Morphometry::default(), &preset.organ, &preset.species, None);
            assert!(!found.compared.is_empty(), "{}", preset.name);
            assert!(found.compared.iter().all(|c| c.measured.is_none() || c.region == "tube"));
        }
    }

    #[test]
    fn a_section_is_compared_with_its_region_and_the_whole_tube() {
        let around = |radius: &dyn Fn(f64) -> f64| -> Vec<[f32; 2]> {
            let turns = (0..6000).map(|i| f64::from(i) / 6000.0 * std::f64::consts::TAU);
            turns.map(|turn| [radius(turn) * turn.cos(), radius(turn) * turn.sin()].map(|um| um as f32)).collect()
        };
        let (outer, lumen) = (around(&|_| 2000.0), around(&|turn| 1300.0 + 500.0 * (30.0 * turn).cos()));
        let measures = measure(&Shape { outer: &outer, lumen: vec![&lumen] }, true);
        let found = compare_section(&measures, "oviduct", "human", Some("ampulla"));
        assert!(!found.is_empty() && found.iter().all(|c| ["ampulla", "whole"].contains(&c.region.as_str())));
        let folds = found.iter().find(|c| c.quantity == "primary_folds").unwrap();
        assert_eq!((folds.measured, folds.verdict), (Some(30.0), Verdict::Inside));
        let all = compare_section(&measures, "oviduct", "human", None);
        assert!(all.len() > found.len() && all.iter().any(|c| c.region == "isthmus" && c.verdict == Verdict::Outside));
        assert!(all.iter().all(|c| c.region != "tube"));
        assert_eq!(compare_section(&measures, "oviduct", "unicorn", None), []);
        assert!(compared_species().any(|pair| pair == ("oviduct", "human")));
        assert!(compared_species().all(|pair| pair != ("oviduct", "mouse")), "only lengths are published");
    }

    fn human(folds: f64) -> Comparison {
        let along = Along { mean: folds, median: folds, sd: 0.0, min: folds, max: folds };
        let quantities = [("primary_folds".to_owned(), along)].into();
        let isthmus = Region { from_mm: 0.0, to_mm: 30.0, sections: 5, quantities };
        let morphometry = Morphometry {
            regions: [("isthmus".to_owned(), isthmus)].into(),
            tube: Tube { length_mm: 100.0, ..Tube::default() },
            ..Morphometry::default()
        };
        compare(&morphometry, "oviduct", "human", None)
    }

    #[test]
    fn a_shortened_length_is_no_deviation() {
        let lengths = |length_mm: f64, shortened: Option<&str>| -> Vec<(Verdict, Option<f64>)> {
            let morphometry = Morphometry { tube: Tube { length_mm, ..Tube::default() }, ..Morphometry::default() };
            let found = compare(&morphometry, "oviduct", "pig", shortened);
            assert_eq!(found.shortened.as_deref(), shortened.filter(|_| length_mm < 277.0));
            let verdicts = [Verdict::Inside, Verdict::Outside];
            let counted = found.compared.iter().filter(|c| verdicts.contains(&c.verdict)).count();
            assert_eq!(found.inside + found.outside, counted);
            let lengths = found.compared.iter().filter(|c| c.quantity == "length_mm");
            lengths.map(|c| (c.verdict, c.deviation_sd)).collect()
        };
        let short = lengths(60.0, Some("by choice"));
        assert!(short.len() >= 3 && short.iter().all(|one| *one == (Verdict::Shortened, None)), "{short:?}");
        let unexplained = lengths(60.0, None);
        assert!(unexplained.iter().all(|one| one.0 == Verdict::Outside));
        assert!(unexplained[0].1.unwrap() < -9.0);
        // The whole length and a longer one are compared as usual.
        assert_eq!(lengths(302.0, Some("by choice"))[0].0, Verdict::Inside);
        assert_eq!(lengths(900.0, Some("by choice"))[0].0, Verdict::Outside);
    }

    #[test]
    fn a_value_whose_method_is_unknown_is_neither_inside_nor_outside() {
        let along = Along { mean: 1.6, median: 1.6, sd: 0.0, min: 1.6, max: 1.6 };
        let quantities = [("fractal_dimension".to_owned(), along)].into();
        let junction = Region { from_mm: 0.0, to_mm: 30.0, sections: 5, quantities };
        let morphometry = Morphometry { regions: [("junction".to_owned(), junction)].into(), ..Morphometry::default() };
        let found = compare(&morphometry, "oviduct", "pig", None);
        let dimension = found.compared.iter().find(|c| c.quantity == "fractal_dimension").unwrap();
        assert_eq!((dimension.measured, dimension.verdict), (Some(1.6), Verdict::MethodUnknown));
        assert_eq!((dimension.low, dimension.high), (Some(1.559), Some(1.77)));
        // Only the length of 0 mm is compared.
        let outside: Vec<&Compared> = found.compared.iter().filter(|c| c.verdict == Verdict::Outside).collect();
        assert!(outside.iter().all(|c| c.quantity == "length_mm"), "{outside:?}");
        assert_eq!((found.inside, found.outside), (0, outside.len()));
        assert_eq!(serde_json::json!(dimension.verdict), "method_unknown");
    }

    #[test]
    fn inside_outside_and_how_far() {
        let folds = |n: f64| {
            let found = human(n).compared.into_iter().find(|c| c.n == Some(100) && c.region == "isthmus").unwrap();
            (found.verdict, found.deviation_sd.unwrap())
        };
        let (verdict, sd) = folds(8.31);
        assert!(verdict == Verdict::Inside && sd.abs() < 1e-9);
        let (verdict, sd) = folds(11.01);
        assert!(verdict == Verdict::Outside && (sd - 3.0).abs() < 1e-9);
        assert_eq!(folds(7.41).0, Verdict::Inside);
        let found = human(8.0);
        // The source uses centimetres.
        let length = found.compared.iter().find(|c| c.quantity == "length_mm").unwrap();
        assert_eq!((length.low, length.high, length.verdict), (Some(70.0), Some(140.0), Verdict::Inside));
        let of = |quantity: &str| found.compared.iter().find(|c| c.quantity == quantity).unwrap().verdict;
        assert_eq!(of("outer_diameter_mm"), Verdict::NotMeasured);
        assert_eq!(of("fold_ratio"), Verdict::NotMeasured);
        assert!(found.no_reference.iter().any(|name| name == "lacunarity"));
        assert!(!found.no_reference.iter().any(|name| name == "primary_folds"));
        let count = |verdict| found.compared.iter().filter(|c| c.verdict == verdict).count();
        assert_eq!((found.inside, found.outside), (count(Verdict::Inside), count(Verdict::Outside)));
    }
}
