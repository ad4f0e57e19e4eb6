//! Verdicts about a model: statement by statement.

use super::expression::Expression;
use super::statement::{BoundOrigin, Condition, StatedSource, Statement, statements};
use super::value::Judged;
use serde::{Deserialize, Serialize};

/// Measure of the tube whose failure has a reason if the preset is shortened.
const LENGTH: &str = "length_mm";

/// Judgement of a model by the checklist of anatomical statements.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Checklist {
    /// Organ.
    pub organ: String,
    /// Species.
    pub species: String,
    /// Number of statements that hold.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub holds: usize,
    /// Number of statements that fail.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub fails: usize,
    /// Number of statements that cannot be judged because the model lacks a measure.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub not_measurable: usize,
    /// Statements about the organ and species, in the order of their numbers.
    pub statements: Vec<CheckedStatement>,
}

/// Statement about the organ and species of a model, and its verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CheckedStatement {
    /// Number of the statement in `references/checklist.json`.
    pub number: u32,
    /// The statement.
    pub statement: String,
    /// `fails` if any condition fails; otherwise `not_measurable` if any is not measurable.
    pub verdict: Judgement,
    /// Conditions for the organ and species.
    pub conditions: Vec<CheckedCondition>,
    /// Sources of the statement; each says how it was learnt.
    pub sources: Vec<String>,
}

/// Condition of a statement, its value for the model, and its verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CheckedCondition {
    /// What is measured.
    pub title: String,
    /// Expression of measures; docs/morphometry.md describes the syntax.
    pub measure: String,
    /// Value of the model; null if it cannot be measured.
    pub measured: Option<f64>,
    /// Lower end of the range.
    pub low: Option<f64>,
    /// Upper end of the range.
    pub high: Option<f64>,
    /// Origin of the range. The ends of an `order` are not part of the range.
    pub bound: BoundOrigin,
    /// Result.
    pub verdict: Judgement,
    /// Reason for the verdict, if one is known: the missing measure, or a choice of the preset.
    pub reason: Option<String>,
}

/// Verdict about a statement or a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Judgement {
    /// The model agrees.
    Holds,
    /// The model disagrees.
    Fails,
    /// The model lacks a measure.
    NotMeasurable,
}

/// Judges a model by all statements about its organ and species; `None` if there is none.
#[must_use]
pub fn judge(model: &Judged<'_>) -> Option<Checklist> {
    let all: Vec<CheckedStatement> = statements().iter().filter_map(|one| checked(model, one)).collect();
    if all.is_empty() {
        return None;
    }
    let count = |verdict| all.iter().filter(|one| one.verdict == verdict).count();
    Some(Checklist {
        organ: model.organ.into(),
        species: model.species.into(),
        holds: count(Judgement::Holds),
        fails: count(Judgement::Fails),
        not_measurable: count(Judgement::NotMeasurable),
        statements: all,
    })
}

pub(super) fn checked(model: &Judged<'_>, statement: &Statement) -> Option<CheckedStatement> {
    let own = statement.conditions.iter().filter(|one| one.applies(model.organ, model.species, model.preset));
    let conditions: Vec<CheckedCondition> = own.map(|one| condition(model, one)).collect();
    if conditions.is_empty() {
        return None;
    }
    let any = |verdict| conditions.iter().any(|one| one.verdict == verdict);
    let verdict = [Judgement::Fails, Judgement::NotMeasurable].into_iter().find(|&verdict| any(verdict));
    let source = |one: &StatedSource| format!("{} [{}]", one.source, one.learnt.words());
    Some(CheckedStatement {
        number: statement.number,
        statement: statement.statement.clone(),
        verdict: verdict.unwrap_or(Judgement::Holds),
        conditions,
        sources: statement.sources.iter().map(source).collect(),
    })
}

fn condition(model: &Judged<'_>, own: &Condition) -> CheckedCondition {
    let parsed = Expression::parse(&own.measure);
    let value = parsed.as_ref().map_err(String::clone).and_then(|expression| model.value(expression));
    let (measured, verdict, reason) = match value {
        Ok(value) if own.contains(value) => (Some(value), Judgement::Holds, None),
        Ok(value) => {
            let is_short = parsed.is_ok_and(|of| of.uses_tube(LENGTH)) && own.low.is_some_and(|low| value < low);
            let reason = model.shortened.filter(|_| is_short);
            (Some(value), Judgement::Fails, reason.map(|why| format!("Shortened by choice: {why}")))
        }
        Err(missing) => (None, Judgement::NotMeasurable, Some(missing)),
    };
    CheckedCondition {
        title: own.title.clone(),
        measure: own.measure.clone(),
        measured,
        low: own.low,
        high: own.high,
        bound: own.bound,
        verdict,
        reason,
    }
}
