//! `GET /docs`: the description of the service as a page, from the same document as
//! `/openapi.yaml`.
//!
//! The page has no scripts and loads nothing. It lists operations by subject, problems, and the
//! schemas of all bodies.

mod html;
mod schemas;

use crate::http::openapi::Description;
use crate::http::wire::problem::Kind;
use axum::Extension;
use axum::http::{HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};
use html::{items, joined, members, prose, table, text};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;
use std::sync::OnceLock;

const POLICY: HeaderValue =
    HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'");
const STYLE: &str = include_str!("docs/style.css");

/// Read this description as a page.
///
/// The page has no scripts and loads nothing.
#[utoipa::path(
    get, path = "/docs", operation_id = "get_docs", tag = "service",
    responses((status = 200, description = "This description as HTML", content_type = "text/html", body = String))
)]
pub(in crate::http) async fn page(Extension(description): Extension<Description>) -> Response {
    static PAGE: OnceLock<String> = OnceLock::new();
    let page = PAGE.get_or_init(|| write(description.0())).as_str();
    ([(header::CONTENT_SECURITY_POLICY, POLICY)], Html(page)).into_response()
}

fn write(document: &Value) -> String {
    let info = |member| text(&document["info"], member);
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (info("title")) " " (info("version")) ": interface" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    h1 { (info("title")) " " small { (info("version")) } }
                    p { (prose(info("description"))) }
                    p { "For programs: " a href="openapi.yaml" { "/openapi.yaml" } "." }
                    nav aria-label="Subjects" {
                        ul {
                            @for tag in items(&document["tags"]) {
                                li { a href={ "#tag-" (text(tag, "name")) } { (text(tag, "name")) } }
                            }
                            li { a href="#problems" { "problems" } }
                            li { a href="#schemas" { "schemas" } }
                        }
                    }
                }
                main {
                    @for tag in items(&document["tags"]) { (subject(document, tag)) }
                    (problems())
                    (schemas::all(&document["components"]["schemas"]))
                }
            }
        }
    };
    page.into_string()
}

/// Section of the operations with a tag.
fn subject(document: &Value, tag: &Value) -> Markup {
    let name = text(tag, "name");
    let operations = members(&document["paths"])
        .flat_map(|(path, item)| members(item).map(move |(method, operation)| (path, method, operation)))
        .filter(|(_, _, operation)| items(&operation["tags"]).any(|tag| tag == name));
    html! {
        section aria-labelledby={ "tag-" (name) } {
            h2 id={ "tag-" (name) } { (name) }
            p { (prose(text(tag, "description"))) }
            @for (path, method, operation) in operations { (self::operation(path, method, operation)) }
        }
    }
}

fn operation(path: &str, method: &str, operation: &Value) -> Markup {
    let id = text(operation, "operationId");
    let parameters = items(&operation["parameters"]).map(|parameter| {
        html! {
            th scope="row" { code { (text(parameter, "name")) } }
            td { (text(parameter, "in")) @if parameter["required"] == true { ", required" } }
            td { (schemas::kind(&parameter["schema"])) }
            td { (prose(text(parameter, "description"))) }
        }
    });
    let responses = members(&operation["responses"]).map(|(status, response)| {
        let headers = members(&response["headers"])
            .map(|(name, value)| html! { code { (name) } ": " (prose(text(value, "description"))) });
        html! {
            th scope="row" { (status) }
            td { (prose(text(response, "description"))) }
            td { (content(&response["content"])) }
            td { (joined(headers, &html! { br; })) }
        }
    });
    let body = &operation["requestBody"]["content"];
    html! {
        article id=(id) {
            h3 { a href={ "#" (id) } { code { (method.to_ascii_uppercase()) " " (path) } } }
            @for paragraph in ["summary", "description"].map(|member| text(operation, member)) {
                @if !paragraph.is_empty() { p { (prose(paragraph)) } }
            }
            (table("Parameters", &["Name", "In", "Type", "Meaning"], parameters.collect()))
            @if body.is_object() { p { "Body: " (content(body)) } }
            (table("Responses", &["Status", "Meaning", "Body", "Headers"], responses.collect()))
        }
    }
}

/// Media types with their schemas.
fn content(content: &Value) -> Markup {
    let media_types = members(content).map(|(media_type, content)| {
        html! {
            code { (media_type) }
            @if let Some(schema) = content.get("schema") { ": " (schemas::kind(schema)) }
        }
    });
    joined(media_types, &html! { br; })
}

fn problems() -> Markup {
    let row = |kind: &Kind| {
        html! {
            th scope="row" { code { (kind.slug()) } }
            td { (kind.status().as_u16()) }
            td { (kind.title()) }
        }
    };
    html! {
        section aria-labelledby="problems" {
            h2 id="problems" { "problems" }
            p {
                "Every error response is a " code { "Problem" } ". Its " code { "type" } " is "
                code { "urn:oviduct:problem:" } " followed by one of these."
            }
            (table("Problems", &["Type", "Status", "Title"], Kind::ALL.iter().map(row).collect()))
        }
    }
}

#[cfg(test)]
mod tests;
