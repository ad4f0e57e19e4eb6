//! Agreement of several models of each preset with the anatomical checklist.

use crate::measure::checklist::{BoundOrigin, CheckedCondition, CheckedStatement, Checklist, Judgement};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Fraction of the models of a preset in which a statement must hold to hold for the preset.
const LEAST_MODELS: f64 = 0.9;

/// Agreement of the models of a preset.
#[derive(Debug, Serialize)]
pub(super) struct Tally {
    preset: String,
    /// Number of models.
    models: usize,
    /// Number of statements that hold for the preset.
    holds: usize,
    fails: usize,
    not_measurable: usize,
    statements: Vec<StatementTally>,
}

#[derive(Debug, Serialize)]
struct StatementTally {
    number: u32,
    statement: String,
    verdict: Judgement,
    #[serde(flatten)]
    counts: Counts,
    conditions: Vec<ConditionTally>,
}

#[derive(Debug, Serialize)]
struct ConditionTally {
    #[serde(flatten)]
    condition: Key,
    #[serde(flatten)]
    counts: Counts,
    /// Mean of the models that can be measured.
    mean: Option<f64>,
    /// Reason of the first model that has one.
    reason: Option<String>,
}

/// Condition without the results of a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Key {
    title: String,
    measure: String,
    low: Option<f64>,
    high: Option<f64>,
    bound: BoundOrigin,
}

/// Numbers of models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
struct Counts {
    holds_in: usize,
    measurable_in: usize,
}

impl Counts {
    fn of(verdicts: impl Iterator<Item = Judgement>) -> Self {
        verdicts.fold(Self { holds_in: 0, measurable_in: 0 }, |counts, verdict| Self {
            holds_in: counts.holds_in + usize::from(verdict == Judgement::Holds),
            measurable_in: counts.measurable_in + usize::from(verdict != Judgement::NotMeasurable),
        })
    }

    fn verdict(self) -> Judgement {
        if self.measurable_in == 0 {
            Judgement::NotMeasurable
        } else if self.holds_in as f64 >= LEAST_MODELS * self.measurable_in as f64 {
            Judgement::Holds
        } else {
            Judgement::Fails
        }
    }

    /// Text for a cell of the table, `7 of 10`.
    fn cell(self) -> String {
        if self.measurable_in == 0 {
            "not measurable".to_owned()
        } else {
            format!("{} of {}", self.holds_in, self.measurable_in)
        }
    }
}

impl Key {
    fn of(one: &CheckedCondition) -> Self {
        let CheckedCondition { title, measure, low, high, bound, .. } = one;
        Self { title: title.clone(), measure: measure.clone(), low: *low, high: *high, bound: *bound }
    }

    fn range(&self) -> String {
        let is_order = self.bound == BoundOrigin::Order;
        let [from, to] = if is_order { ["above", "below"] } else { ["at least", "at most"] };
        let range = match (self.low, self.high) {
            (None, None) => String::new(),
            (Some(low), None) => format!("{from} {low}"),
            (None, Some(high)) => format!("{to} {high}"),
            (Some(low), Some(high)) if low == high => low.to_string(),
            (Some(low), Some(high)) => format!("{low} to {high}"),
        };
        match self.bound {
            BoundOrigin::Published => range,
            BoundOrigin::Order => format!("{range} (order)"),
            BoundOrigin::Proposal => format!("{range} (proposal)"),
        }
    }
}

/// Tallies the judgements of the models of a preset. All of them have the same statements.
pub(super) fn tally(preset: &str, models: &[&Checklist]) -> Tally {
    let count = models.first().map_or(0, |first| first.statements.len());
    let statements: Vec<StatementTally> = (0..count)
        .filter_map(|k| StatementTally::of(&models.iter().filter_map(|one| one.statements.get(k)).collect::<Vec<_>>()))
        .collect();
    let with = |verdict| statements.iter().filter(|one| one.verdict == verdict).count();
    Tally {
        preset: preset.to_owned(),
        models: models.len(),
        holds: with(Judgement::Holds),
        fails: with(Judgement::Fails),
        not_measurable: with(Judgement::NotMeasurable),
        statements,
    }
}

impl StatementTally {
    fn of(models: &[&CheckedStatement]) -> Option<Self> {
        let first = *models.first()?;
        let counts = Counts::of(models.iter().map(|one| one.verdict));
        let conditions = (0..first.conditions.len())
            .filter_map(|k| {
                ConditionTally::of(&models.iter().filter_map(|one| one.conditions.get(k)).collect::<Vec<_>>())
            })
            .collect();
        let verdict = counts.verdict();
        Some(Self { number: first.number, statement: first.statement.clone(), verdict, counts, conditions })
    }
}

impl ConditionTally {
    fn of(models: &[&CheckedCondition]) -> Option<Self> {
        let values: Vec<f64> = models.iter().filter_map(|one| one.measured).collect();
        Some(Self {
            condition: Key::of(models.first()?),
            counts: Counts::of(models.iter().map(|one| one.verdict)),
            mean: (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64),
            reason: models.iter().find_map(|one| one.reason.clone()),
        })
    }

    fn cell(&self) -> String {
        match self.mean {
            Some(mean) => format!("{}; {}", self.counts.cell(), number(mean)),
            None => self.counts.cell(),
        }
    }
}

/// Formats a value with three digits.
pub(super) fn number(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { (2 - value.abs().log10().floor() as i32).clamp(0, 4) };
    format!("{value:.*}", digits as usize)
}

/// The tallies as one table, after one line per preset.
pub(super) fn markdown(tallies: &[Tally]) -> String {
    let mut text = String::from("### Checklist\n\n");
    for Tally { preset, models, holds, fails, not_measurable, statements } in tallies {
        if statements.is_empty() {
            let _ = writeln!(text, "- `{preset}`: no statement is about this organ.");
            continue;
        }
        let of = holds + fails;
        let all = of + not_measurable;
        let _ = writeln!(
            text,
            "- `{preset}`: {holds} of {of} measurable statements hold in at least nine tenths of {models} models; \
             {not_measurable} of {all} are not measurable."
        );
    }
    let header: String = tallies.iter().map(|one| format!(" `{}` |", one.preset)).collect();
    let _ = writeln!(text, "\n| | statement, measure | range |{header}");
    let _ = writeln!(text, "|---|---|---|{}", "---|".repeat(tallies.len()));
    // The statements of all presets, in the order of their numbers, with all of their conditions.
    let mut all: BTreeMap<u32, (&str, Vec<&Key>)> = BTreeMap::new();
    for one in tallies.iter().flat_map(|tally| &tally.statements) {
        let (_, keys) = all.entry(one.number).or_insert_with(|| (&one.statement, Vec::new()));
        for condition in &one.conditions {
            if !keys.contains(&&condition.condition) {
                keys.push(&condition.condition);
            }
        }
    }
    for (number, (statement, keys)) in all {
        let of = |tally: &'_ Tally| tally.statements.iter().position(|one| one.number == number);
        let cells: String =
            tallies.iter().map(|tally| statement_cell(of(tally).map(|k| &tally.statements[k]))).collect();
        let _ = writeln!(text, "| {number} | **{statement}** | |{cells}");
        for key in keys {
            let cells: String = tallies.iter().map(|tally| condition_cell(tally, number, key)).collect();
            let _ = writeln!(text, "| | {} | {} |{cells}", key.title, key.range());
        }
    }
    text + &reasons(tallies)
}

fn statement_cell(one: Option<&StatementTally>) -> String {
    one.map_or_else(|| " – |".to_owned(), |one| format!(" **{}** |", one.counts.cell()))
}

fn condition_cell(tally: &Tally, number: u32, key: &Key) -> String {
    let mut own = tally.statements.iter().filter(|one| one.number == number).flat_map(|one| &one.conditions);
    own.find(|one| one.condition == *key).map_or_else(|| " – |".to_owned(), |one| format!(" {} |", one.cell()))
}

/// Reasons of verdicts, one line for each statement and preset.
fn reasons(tallies: &[Tally]) -> String {
    let mut text = String::new();
    for tally in tallies {
        for one in &tally.statements {
            let mut all: Vec<&str> = one.conditions.iter().filter_map(|of| of.reason.as_deref()).collect();
            all.dedup();
            if !all.is_empty() {
                let _ = writeln!(text, "- `{}`, {}: {}", tally.preset, one.number, all.join("; "));
            }
        }
    }
    if text.is_empty() { text } else { format!("\nReasons:\n\n{text}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn condition(title: &str, low: f64, measured: Option<f64>) -> CheckedCondition {
        let verdict = match measured {
            Some(value) if value >= low => Judgement::Holds,
            Some(_) => Judgement::Fails,
            None => Judgement::NotMeasurable,
        };
        let reason = measured.is_none().then(|| "`it` is not measured".to_owned());
        CheckedCondition {
            title: title.into(),
            measure: "it@isthmus".into(),
            measured,
            low: Some(low),
            high: None,
            bound: BoundOrigin::Proposal,
            verdict,
            reason,
        }
    }

    fn model(number: u32, conditions: Vec<CheckedCondition>) -> Checklist {
        let any = |verdict| conditions.iter().any(|one| one.verdict == verdict);
        let verdict = [Judgement::Fails, Judgement::NotMeasurable].into_iter().find(|&verdict| any(verdict));
        let statement = CheckedStatement {
            number,
            statement: format!("Statement {number}."),
            verdict: verdict.unwrap_or(Judgement::Holds),
            conditions,
            sources: Vec::new(),
        };
        Checklist {
            organ: "oviduct".into(),
            species: "pig".into(),
            holds: 0,
            fails: 0,
            not_measurable: 0,
            statements: vec![statement],
        }
    }

    fn tallied(preset: &str, low: f64, values: &[Option<f64>]) -> Tally {
        let models: Vec<Checklist> = values.iter().map(|value| model(7, vec![condition("it", low, *value)])).collect();
        tally(preset, &models.iter().collect::<Vec<_>>())
    }

    #[test]
    fn a_statement_holds_for_a_preset_in_nine_of_ten_models() {
        let values = |holding: usize| -> Vec<Option<f64>> {
            (0..10).map(|i| Some(if i < holding { 3.0 } else { 1.0 })).collect()
        };
        for (holding, expected) in [(10, [1, 0, 0]), (9, [1, 0, 0]), (8, [0, 1, 0]), (0, [0, 1, 0])] {
            let found = tallied("pig", 2.0, &values(holding));
            assert_eq!([found.holds, found.fails, found.not_measurable], expected, "{holding}");
            let counts = Counts { holds_in: holding, measurable_in: 10 };
            assert_eq!((found.statements[0].counts, found.statements[0].conditions[0].counts), (counts, counts));
        }
        let mean = tallied("pig", 2.0, &values(5)).statements[0].conditions[0].mean.unwrap();
        assert!((mean - 2.0).abs() < 1e-12);
        let none = tallied("pig", 2.0, &[None, None]);
        assert_eq!([none.holds, none.fails, none.not_measurable], [0, 0, 1]);
        assert_eq!(tally("colon", &[]).statements.len(), 0);
    }

    #[test]
    fn the_table_has_a_row_for_each_range_and_a_column_for_each_preset() {
        let (values, none) = ([Some(3.0), Some(1.0)], [None, None]);
        let text = markdown(&[
            tallied("pig", 2.0, &values),
            tallied("cow", 2.0, &none),
            tallied("human", 0.5, &values),
            tally("colon", &[]),
        ]);
        for line in [
            "- `pig`: 0 of 1 measurable statements hold in at least nine tenths of 2 models; 0 of 1 are not measurable.",
            "- `cow`: 0 of 0 measurable statements hold in at least nine tenths of 2 models; 1 of 1 are not measurable.",
            "- `human`: 1 of 1 measurable statements hold in at least nine tenths of 2 models; 0 of 1 are not measurable.",
            "- `colon`: no statement is about this organ.",
            "| | statement, measure | range | `pig` | `cow` | `human` | `colon` |",
            "| 7 | **Statement 7.** | | **1 of 2** | **not measurable** | **2 of 2** | – |",
            "| | it | at least 2 (proposal) | 1 of 2; 2.00 | not measurable | – | – |",
            "| | it | at least 0.5 (proposal) | – | – | 2 of 2; 2.00 | – |",
            "- `cow`, 7: `it` is not measured",
        ] {
            assert!(text.lines().any(|own| own == line), "{line}\n{text}");
        }
    }

    #[test]
    fn ranges_name_their_origin() {
        let key = |low, high, bound| Key { title: String::new(), measure: String::new(), low, high, bound };
        assert_eq!(key(Some(7.41), Some(9.21), BoundOrigin::Published).range(), "7.41 to 9.21");
        assert_eq!(key(Some(1.0), None, BoundOrigin::Order).range(), "above 1 (order)");
        assert_eq!(key(None, Some(0.15), BoundOrigin::Proposal).range(), "at most 0.15 (proposal)");
        assert_eq!(key(Some(11.0), Some(11.0), BoundOrigin::Published).range(), "11");
    }
}
