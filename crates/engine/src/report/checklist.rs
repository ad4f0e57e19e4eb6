//! Section of the page with the anatomical checklist.

use super::number::{optional, range};
use crate::measure::checklist::{BoundOrigin, CheckedCondition, CheckedStatement, Checklist, Judgement};
use maud::{Markup, html};

pub(super) fn checklist(found: &Checklist) -> Markup {
    let measurable = found.holds + found.fails;
    html! {
        h2 { "Checklist of anatomy" }
        p {
            (found.holds) " of " (measurable) " measurable statements about the " (found.organ) " (" (found.species) ") hold"
            @if found.not_measurable > 0 { "; " (found.not_measurable) " cannot be measured" } "."
        }
        div.scroll { table {
            thead { tr { th.n { "" } th { "Statement and measure" } th.n { "Model" } th.n { "Range" } th { "" } th { "Source" } } }
            tbody { @for one in &found.statements { (statement(one)) } }
        } }
        p.small.soft {
            "A statement holds if all of its measures are in their ranges. The limit of an order (above, below) is published "
            "as an order without numbers. A proposal is this project's own number."
        }
    }
}

fn statement(one: &CheckedStatement) -> Markup {
    html! {
        tr.statement {
            td.n { (one.number) }
            td colspan="3" { strong { (one.statement) } }
            td { (verdict(one.verdict)) }
            td.source { (one.sources.join("; ")) }
        }
        @for condition in &one.conditions { (measure(condition)) }
    }
}

fn measure(one: &CheckedCondition) -> Markup {
    html! {
        tr {
            td {}
            td { (one.title) @if let Some(reason) = &one.reason { br; span.soft { (reason) } } }
            td.n { (optional(one.measured)) }
            td.n { (range(one.low, one.high, one.bound == BoundOrigin::Order)) }
            td { (verdict(one.verdict)) }
            td.source {
                @match one.bound {
                    BoundOrigin::Published => "published range",
                    BoundOrigin::Order => "published order",
                    BoundOrigin::Proposal => "proposal",
                }
            }
        }
    }
}

fn verdict(verdict: Judgement) -> Markup {
    html! {
        @match verdict {
            Judgement::Holds => span.inside { "holds" },
            Judgement::Fails => span.outside { "fails" },
            Judgement::NotMeasurable => span.soft { "not measurable" },
        }
    }
}
