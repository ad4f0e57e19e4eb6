//! Judgement of a model by a checklist of thirty anatomical statements.
//!
//! The statements are `references/checklist.json`, compiled in: each has its sources and one or
//! more conditions. A condition is an expression of measures with a range, for one or more species.
//!
//! | file | subject |
//! |---|---|
//! | `statement` | the statements and their conditions |
//! | `expression` | expressions of measures: syntax |
//! | `value` | value of an expression for a model |
//! | `judge` | verdicts |

mod expression;
mod judge;
mod statement;
mod value;

pub use judge::{CheckedCondition, CheckedStatement, Checklist, Judgement, judge};
pub use statement::{BoundOrigin, Condition, Learnt, StatedSource, Statement, statements};
pub use value::Judged;

#[cfg(test)]
mod tests;
