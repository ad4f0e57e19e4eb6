//! The index: all figures with their captions on one page that needs no other file.

use super::made::Made;
use crate::cli::bench::machine;
use crate::report::STYLE;
use base64::Engine as _;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;

pub(super) fn page(figures: &[Made], document: &Value) -> Markup {
    let text = |name: &str| document[name].as_str().unwrap_or_default().to_owned();
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "The paper's figures · oviduct" }
                style { (PreEscaped(STYLE)) "svg { display: block; max-width: 100%; height: auto; }" }
            }
            body {
                h1 { "The paper's figures" }
                p.soft {
                    "Figures of Burkitt, Romano, Walker and Fazeli, 3D Modelling of Complex Biological Structures: The Oviduct, made again by oviduct "
                    (text("engine")) " on " (machine::line()) ", " (text("date")) ". Preset " (text("preset")) ", seed " (document["seed"])
                    ", digest " code { (text("digest")) } ". The numbers behind them are in figures.json."
                }
                @for made in figures {
                    h2 { "Figure " (made.number) ". " (made.title) }
                    figure {
                        @for (name, bytes) in &made.files { (picture(name, bytes, made.title)) }
                        figcaption { @for sentence in &made.caption { (sentence) " " } }
                    }
                }
            }
        }
    }
}

fn picture(name: &str, bytes: &[u8], title: &str) -> Markup {
    if name.ends_with(".svg") {
        return html! { (PreEscaped(String::from_utf8_lossy(bytes))) };
    }
    let data = format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes));
    html! { img alt=(title) src=(data); }
}
