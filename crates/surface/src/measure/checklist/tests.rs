//! Tests of expressions, of their values, and of verdicts.

use super::expression::{Expression, Operator, Place};
use super::judge::checked;
use super::*;
use crate::measure::morphometry::{Along, Morphometry, Region, Tube};
use serde_json::json;
use std::collections::BTreeMap;

/// Places of the sections of [`model`], mm.
const Z: [f64; 6] = [0.0, 20.0, 40.0, 60.0, 80.0, 100.0];

/// Model of 100 mm. `a` is known everywhere, `b` from 40 mm on; there are no folds at 0 mm.
fn model() -> Morphometry {
    let quantity = |values: [Option<f64>; 6]| values.to_vec();
    let along: BTreeMap<String, Vec<Option<f64>>> = [
        ("z_mm".to_owned(), quantity(Z.map(Some))),
        ("a".to_owned(), quantity([10.0, 8.0, 6.0, 5.0, 4.0, 3.0].map(Some))),
        ("b".to_owned(), quantity([None, None, Some(2.0), Some(2.0), Some(2.0), Some(2.0)])),
        ("primary_folds".to_owned(), quantity([0.0, 2.0, 4.0, 4.0, 4.0, 4.0].map(Some))),
        ("fold_height_p50_um".to_owned(), quantity([None, Some(50.0), None, Some(90.0), Some(90.0), Some(90.0)])),
    ]
    .into();
    let mean = |mean| Along { mean, median: mean, sd: 0.0, min: mean, max: mean };
    let region = |from_mm, to_mm, a| Region {
        from_mm,
        to_mm,
        sections: 2,
        quantities: [("a".to_owned(), mean(a)), ("per_mm".to_owned(), mean(a / 10.0))].into(),
    };
    Morphometry {
        along,
        regions: [("isthmus".to_owned(), region(0.0, 30.0, 9.0)), ("ampulla".to_owned(), region(40.0, 100.0, 4.5))]
            .into(),
        tube: Tube { length_mm: 100.0, ..Tube::default() },
        ..Morphometry::default()
    }
}

fn parameter(preset: Option<&str>, pointer: &str) -> Option<f64> {
    match (preset, pointer) {
        (None, "/regions/junction_from") => Some(0.3),
        (Some("long"), "/length_mm") => Some(200.0),
        _ => None,
    }
}

fn with<T>(morphometry: &Morphometry, of: impl FnOnce(&Judged<'_>) -> T) -> T {
    let tube = [("coil_turns", 11.0)].into();
    of(&Judged {
        morphometry,
        organ: "oviduct",
        species: "pig",
        preset: "pig",
        length_mm: 100.0,
        shortened: Some("half of it is enough."),
        tube: &tube,
        parameter: &parameter,
    })
}

fn value(text: &str) -> Result<f64, String> {
    with(&model(), |judged| judged.value(&Expression::parse(text)?))
}

#[track_caller]
fn assert_value(text: &str, expected: f64) {
    let found = value(text).unwrap_or_else(|why| panic!("{text}: {why}"));
    assert!((found - expected).abs() < 1e-12, "{text}: {found}, not {expected}");
}

#[test]
fn expressions_are_parsed_with_the_usual_precedence() {
    let parsed = Expression::parse("a@0.10..0.20 / b@ampulla").unwrap();
    let at = |quantity: &str, place| Box::new(Expression::At(quantity.into(), place));
    let parts = Place::Parts([0.1, 0.2]);
    assert_eq!(parsed, Expression::Binary(at("a", parts), Operator::Divide, at("b", Place::Region("ampulla".into()))));
    assert_value("2 + 3 * 4", 14.0);
    assert_value("(2 + 3) * 4", 20.0);
    assert_value("20 - 8 - 2", 10.0);
    assert_value("20 / 4 / 2", 2.5);
    assert_value("1.5 - 0.25", 1.25);
}

#[test]
fn texts_that_are_no_expressions_are_refused() {
    for (text, told) in [
        ("", "a name"),
        ("a@", "a name"),
        ("a", "("),
        ("1 +", "a name"),
        ("(1", ")"),
        ("1 2", "the end"),
        ("a@0.5..0.2", "no range"),
        ("a@0.5..1.5", "no range"),
        ("a@0.5", ".."),
        ("rising(1, 2)", "no function"),
        ("falling(1)", ","),
        ("least_at(a, 1)", "parts"),
        ("least_at(a, 2.5)", "parts"),
        ("spec()", "pointer"),
        ("tube", "."),
    ] {
        let why = Expression::parse(text).unwrap_err();
        assert!(why.contains(told), "{text}: {why}");
    }
}

#[test]
fn means_are_those_of_a_region_or_of_a_range() {
    assert_value("a@isthmus", 9.0);
    assert_value("per_mm@ampulla", 0.45);
    // Straight lines between the sections: 8 at 0.2, 6 at 0.4, 5 at 0.6.
    assert_value("a@0.2..0.4", 7.0);
    assert_value("a@0.3..0.5", (0.1 * 6.5 + 0.1 * 5.75) / 0.2);
    assert_value("a@0..1", (9.0 + 7.0 + 5.5 + 4.5 + 3.5) / 5.0);
    assert_value("b@0.4..0.6", 2.0);
    // Known in three quarters of the range, and in a quarter.
    assert_value("b@0.3..0.7", 2.0);
    assert!(value("b@0..0.5").unwrap_err().contains("no value from 0 to 0.5"));
}

#[test]
fn what_is_missing_is_named() {
    for (text, told) in [
        ("nothing@0.1..0.2", "`nothing` is not measured"),
        ("nothing@isthmus", "`nothing` is not measured"),
        ("a@junction", "`a` has no value in the region `junction`"),
        ("b@0..0.2", "`b` has no value from 0 to 0.2 of the length"),
        ("per_mm@0..0.2", "`per_mm` has no value"),
        ("free_lumen_of_nothing@ampulla / a@ampulla", "`free_lumen_of_nothing` is not measured"),
        ("tube.colour", "`colour` of the tube"),
        ("spec(/colour)", "no number at `/colour`"),
        ("preset(short, /length_mm)", "of the preset `short`"),
        ("1 / 0", "divided"),
        ("falling(a@isthmus, nothing@isthmus)", "`nothing`"),
        ("least_at(b, 4)", "`b` has no value from 0 to 0.25"),
    ] {
        let why = value(text).unwrap_err();
        assert!(why.contains(told), "{text}: {why}");
    }
}

#[test]
fn functions_and_measures_of_the_tube() {
    assert_value("falling(a@isthmus, a@ampulla)", 0.5);
    assert_value("falling(8, 4, 3)", 0.25);
    assert_value("falling(4, 8, 3)", -0.5);
    assert_value("falling(0, 0)", 0.0);
    assert_value("falling(1, 0)", 1.0);
    assert_value("least_at(a, 5)", 0.9);
    assert_value("least_at(fold_height_p50_um, 2)", 0.25);
    assert_value("tube.length_mm", 100.0);
    assert_value("tube.coil_turns", 11.0);
    assert_value("spec(/regions/junction_from)", 0.3);
    assert_value("preset(long, /length_mm) / tube.length_mm", 2.0);
}

#[test]
fn a_section_without_folds_has_folds_of_no_height() {
    // 0 at 0, 50 at 0.2, interpolated at 0.4, 90 at 0.6.
    assert_value("fold_height_p50_um@0..0.2", 25.0);
    assert_value("fold_height_p50_um@0.2..0.6", 70.0);
    let mut unknown = model();
    unknown.along.remove("primary_folds");
    let why = with(&unknown, |judged| judged.value(&Expression::parse("fold_height_p50_um@0..0.2").unwrap()));
    assert!(why.unwrap_err().contains("no value"));
}

/// Verdict, value and reason of the only condition of a statement.
fn judged(measure: &str, low: Option<f64>, high: Option<f64>, bound: &str) -> (Judgement, Option<f64>, Option<String>) {
    let statement = json!({
        "number": 1, "statement": "It is so.", "sources": [{ "source": "A book", "learnt": "memory" }],
        "conditions": [{
            "title": "it", "species": ["pig"], "measure": measure, "low": low, "high": high, "bound": bound,
        }],
    });
    let statement: Statement = serde_json::from_value(statement).unwrap();
    let found = with(&model(), |judged| checked(judged, &statement)).unwrap();
    assert_eq!(found.sources, ["A book [from memory]"]);
    let condition = found.conditions.into_iter().next().unwrap();
    assert_eq!(found.verdict, condition.verdict);
    (condition.verdict, condition.measured, condition.reason)
}

#[test]
fn each_verdict() {
    use Judgement::{Fails, Holds, NotMeasurable};
    let verdict = |low, high, bound: &str| judged("a@isthmus", low, high, bound).0;
    assert_eq!(verdict(Some(8.0), Some(10.0), "published"), Holds);
    assert_eq!(verdict(Some(9.5), None, "published"), Fails);
    assert_eq!(verdict(None, Some(8.5), "proposal"), Fails);
    // The ends belong to a range, but not to an order.
    assert_eq!(verdict(Some(9.0), None, "proposal"), Holds);
    assert_eq!(verdict(None, Some(9.0), "published"), Holds);
    assert_eq!(verdict(Some(9.0), None, "order"), Fails);
    assert_eq!(verdict(None, Some(9.0), "order"), Fails);
    assert_eq!(verdict(Some(8.9), None, "order"), Holds);
    let (verdict, measured, reason) = judged("a@nowhere", Some(1.0), None, "order");
    assert_eq!((verdict, measured), (NotMeasurable, None));
    assert!(reason.unwrap().contains("`a`"));
}

#[test]
fn a_short_tube_of_a_shortened_preset_says_why() {
    let (verdict, measured, reason) = judged("tube.length_mm", Some(277.0), Some(327.0), "published");
    assert_eq!((verdict, measured), (Judgement::Fails, Some(100.0)));
    assert_eq!(reason.unwrap(), "Shortened by choice: half of it is enough.");
    // A tube that is too long, and a ratio that is too small, have no such reason.
    assert_eq!(judged("tube.length_mm", None, Some(50.0), "published").2, None);
    assert_eq!(judged("a@isthmus", Some(50.0), None, "published").2, None);
}

#[test]
fn a_statement_holds_if_all_of_its_conditions_hold() {
    let verdict = |measures: &[(&str, f64)]| {
        let condition = |&(measure, low): &(&str, f64)| json!({ "title": "it", "species": ["pig"], "measure": measure, "low": low, "bound": "proposal" });
        let statement = json!({
            "number": 1, "statement": "It is so.", "sources": [],
            "conditions": measures.iter().map(condition).collect::<Vec<_>>(),
        });
        let statement: Statement = serde_json::from_value(statement).unwrap();
        with(&model(), |judged| checked(judged, &statement)).unwrap().verdict
    };
    let (holds, fails, missing) = (("a@isthmus", 1.0), ("a@isthmus", 20.0), ("c@isthmus", 1.0));
    assert_eq!(verdict(&[holds, holds]), Judgement::Holds);
    assert_eq!(verdict(&[holds, missing, fails]), Judgement::Fails);
    assert_eq!(verdict(&[holds, missing]), Judgement::NotMeasurable);
}

#[test]
fn conditions_apply_to_their_organ_species_and_presets() {
    let condition = |more: serde_json::Value| -> Condition {
        let mut whole = json!({ "title": "it", "species": ["pig", "cow"], "measure": "1", "low": 0, "bound": "order" });
        whole.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        serde_json::from_value(whole).unwrap()
    };
    let any = condition(json!({}));
    assert!(any.applies("oviduct", "pig", "paper") && any.applies("oviduct", "cow", "cow"));
    assert!(!any.applies("oviduct", "human", "human") && !any.applies("infundibulum", "pig", "pig"));
    let of_one = condition(json!({ "presets": ["pig"] }));
    assert!(of_one.applies("oviduct", "pig", "pig") && !of_one.applies("oviduct", "pig", "pig-luteal"));
    assert!(condition(json!({ "organ": "infundibulum" })).applies("infundibulum", "pig", "pig"));
}

#[test]
fn every_statement_is_consistent() {
    let presets = oviduct_spec::spec::presets();
    assert_eq!(statements().iter().map(|s| s.number).collect::<Vec<_>>(), (1..=30).collect::<Vec<_>>());
    for Statement { number, statement, sources, conditions, .. } in statements() {
        assert!(!sources.is_empty() && !conditions.is_empty() && statement.ends_with('.'), "{number}");
        for condition in conditions {
            let Condition { title, species, presets: only, measure, low, high, bound, .. } = condition;
            Expression::parse(measure).unwrap_or_else(|why| panic!("{number}, {measure}: {why}"));
            let known: Vec<f64> = [*low, *high].into_iter().flatten().collect();
            assert!(!known.is_empty() && known.is_sorted(), "{number}, {title}");
            // An order is a relation to equality: a ratio of 1, or a difference or number of 0.
            let is_order = known.len() == 1 && [0.0, 1.0].contains(&known[0]);
            assert!(*bound != BoundOrigin::Order || is_order, "{number}, {title}: {known:?}");
            for species in species {
                let applies = |of: &&oviduct_spec::spec::Preset| condition.applies(&of.organ, species, &of.name);
                let own = presets.iter().filter(|of| of.species == *species).filter(applies).count();
                assert!(own > 0, "{number}, {title}: no preset of {species}");
            }
            for name in only.iter().flatten() {
                assert!(oviduct_spec::spec::preset(name).is_some(), "{number}, {title}: {name}");
            }
        }
    }
}

#[test]
fn every_quantity_of_the_checklist_is_measured() {
    use crate::measure::morphometry::Quantity;
    /// Quantities along the tube, which no single section has.
    const ALONG: [&str; 3] = ["fold_splits_per_mm", "fold_joins_per_mm", "blind_pockets_per_mm"];
    for condition in statements().iter().flat_map(|one| &one.conditions) {
        for name in Expression::parse(&condition.measure).unwrap().quantities() {
            assert!(Quantity::named(name).is_some() || ALONG.contains(&name), "{name}");
        }
    }
}

#[test]
fn a_model_of_a_known_organ_is_judged_by_all_of_its_statements() {
    let empty = Morphometry::default();
    let found = with(&empty, judge).unwrap();
    assert_eq!((found.organ.as_str(), found.species.as_str()), ("oviduct", "pig"));
    assert_eq!(found.holds + found.fails + found.not_measurable, found.statements.len());
    assert!(found.statements.len() >= 20 && found.not_measurable >= 15);
    let own = found.statements.iter().all(|one| !one.conditions.is_empty() && !one.sources.is_empty());
    assert!(own && !found.statements.iter().any(|one| one.number == 29), "the mouse's coil");
    with(&empty, |judged| {
        assert!(judge(&Judged { organ: "colon", ..*judged }).is_none());
        let mouse = judge(&Judged { species: "mouse", preset: "mouse", ..*judged }).unwrap();
        assert!(mouse.statements.iter().any(|one| one.number == 29));
        assert!(mouse.statements.len() < found.statements.len());
    });
    let json = serde_json::to_value(&found).unwrap();
    assert_eq!(serde_json::from_value::<Checklist>(json).unwrap(), found);
}
