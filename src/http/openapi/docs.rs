//! `GET /docs`: the description of the service as a page, generated from the same document as `/openapi.yaml`.
//!
//! The page has no scripts and loads nothing. It lists operations by subject, problems, and the schemas of all bodies.

mod html;
mod schemas;

use crate::http::openapi::Description;
use crate::http::wire::problem::Kind;
use axum::Extension;
use axum::http::{HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};
use html::{escape, items, members, prose, table, text};
use serde_json::Value;
use std::sync::OnceLock;

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
    let tags: Vec<&str> = items(&document["tags"]).map(|tag| text(tag, "name")).collect();
    let links: String = tags.iter().map(|&tag| format!("<li><a href=\"#tag-{0}\">{0}</a></li>", escape(tag))).collect();
    let subjects: String = items(&document["tags"]).map(|tag| subject(document, tag)).collect();
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title} {version}: interface</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<header>\n<h1>{title} <small>{version}</small></h1>\n<p>{description}</p>\n\
         <p>For programs: <a href=\"openapi.yaml\">/openapi.yaml</a>.</p>\n<nav aria-label=\"Subjects\"><ul>{links}\
         <li><a href=\"#problems\">problems</a></li><li><a href=\"#schemas\">schemas</a></li></ul></nav>\n</header>\n<main>\n\
         {subjects}{problems}{schemas}</main>\n</body>\n</html>\n",
        title = escape(text(&document["info"], "title")),
        version = escape(text(&document["info"], "version")),
        description = prose(text(&document["info"], "description")),
        problems = problems(),
        schemas = schemas::all(&document["components"]["schemas"]),
    )
}

const POLICY: HeaderValue =
    HeaderValue::from_static("default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'");

const STYLE: &str = include_str!("docs/style.css");

/// The operations of one tag.
fn subject(document: &Value, tag: &Value) -> String {
    let name = text(tag, "name");
    let operations: String = members(&document["paths"])
        .flat_map(|(path, item)| members(item).map(move |(method, operation)| (path, method, operation)))
        .filter(|(_, _, operation)| items(&operation["tags"]).any(|tag| tag == name))
        .map(|(path, method, operation)| self::operation(path, method, operation))
        .collect();
    format!(
        "<section aria-labelledby=\"tag-{name}\">\n<h2 id=\"tag-{name}\">{name}</h2>\n<p>{}</p>\n{operations}</section>\n",
        prose(text(tag, "description")),
        name = escape(name),
    )
}

fn operation(path: &str, method: &str, operation: &Value) -> String {
    let id = escape(text(operation, "operationId"));
    let description: String = ["summary", "description"]
        .map(|member| text(operation, member))
        .into_iter()
        .filter(|t| !t.is_empty())
        .fold(String::new(), |all, part| format!("{all}<p>{}</p>\n", prose(part)));
    let parameters: Vec<String> = items(&operation["parameters"])
        .map(|parameter| {
            let required = if parameter["required"] == true { ", required" } else { "" };
            let name = escape(text(parameter, "name"));
            let place = escape(text(parameter, "in"));
            let kind = schemas::kind(&parameter["schema"]);
            let description = prose(text(parameter, "description"));
            format!("<th scope=\"row\"><code>{name}</code></th><td>{place}{required}</td><td>{kind}</td><td>{description}</td>")
        })
        .collect();
    let body = match content(&operation["requestBody"]["content"]) {
        none if none.is_empty() => none,
        body => format!("<p>Body: {body}</p>\n"),
    };
    let responses: Vec<String> = members(&operation["responses"])
        .map(|(status, response)| {
            let headers: Vec<String> = members(&response["headers"])
                .map(|(name, value)| format!("<code>{}</code>: {}", escape(name), prose(text(value, "description"))))
                .collect();
            format!(
                "<th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td>",
                escape(status),
                prose(text(response, "description")),
                content(&response["content"]),
                headers.join("<br>"),
            )
        })
        .collect();
    format!(
        "<article id=\"{id}\">\n<h3><a href=\"#{id}\"><code>{} {}</code></a></h3>\n{description}{}{body}{}</article>\n",
        method.to_ascii_uppercase(),
        escape(path),
        table("Parameters", &["Name", "In", "Type", "Meaning"], &parameters),
        table("Responses", &["Status", "Meaning", "Body", "Headers"], &responses),
    )
}

/// Media types with their schemas.
fn content(content: &Value) -> String {
    let one = |(media_type, content): (&String, &Value)| {
        let media_type = format!("<code>{}</code>", escape(media_type));
        match content.get("schema") {
            Some(schema) => format!("{media_type}: {}", schemas::kind(schema)),
            None => media_type,
        }
    };
    members(content).map(one).collect::<Vec<_>>().join("<br>")
}

/// Every kind of problem.
fn problems() -> String {
    let row = |kind: &Kind| {
        let (slug, status, title) = (kind.slug(), kind.status(), escape(kind.title()));
        format!("<th scope=\"row\"><code>{slug}</code></th><td>{}</td><td>{title}</td>", status.as_u16())
    };
    let rows: Vec<String> = Kind::ALL.iter().map(row).collect();
    format!(
        "<section aria-labelledby=\"problems\">\n<h2 id=\"problems\">problems</h2>\n<p>{}</p>\n{}</section>\n",
        prose("Every error response is a `Problem`. Its `type` is `urn:oviduct:problem:` followed by one of these."),
        table("Problems", &["Type", "Status", "Title"], &rows),
    )
}

#[cfg(test)]
mod tests;
