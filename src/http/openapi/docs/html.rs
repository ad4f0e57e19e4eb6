//! Elements of the page, and access to members of JSON.

use maud::{Markup, html};
use serde_json::Value;

/// Text as HTML: text in backquotes is code, an empty line separates paragraphs.
pub(super) fn prose(text: &str) -> Markup {
    let paragraph = |paragraph: &str| {
        html! {
            @for (i, part) in paragraph.split('`').enumerate() {
                @if i % 2 == 1 { code { (part) } } @else { (part) }
            }
        }
    };
    joined(text.split("\n\n").map(paragraph), &html! { br; })
}

pub(super) fn joined(parts: impl Iterator<Item = Markup>, separator: &Markup) -> Markup {
    html! {
        @for (i, part) in parts.enumerate() {
            @if i > 0 { (separator) }
            (part)
        }
    }
}

/// A table of rows of cells; nothing if there are no rows.
pub(super) fn table(caption: &str, columns: &[&str], rows: Vec<Markup>) -> Markup {
    html! {
        @if !rows.is_empty() {
            div.wide tabindex="0" role="group" aria-label=(caption) {
                table {
                    caption { (caption) }
                    thead { tr { @for column in columns { th scope="col" { (column) } } } }
                    tbody { @for row in rows { tr { (row) } } }
                }
            }
        }
    }
}

pub(super) fn text<'v>(value: &'v Value, member: &str) -> &'v str {
    value[member].as_str().unwrap_or_default()
}

pub(super) fn items(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

pub(super) fn members(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flatten()
}
