//! `GET /docs`: the description of the service as a page, made from the same document as `/openapi.yaml`.
//!
//! One page without scripts, that loads nothing: operations by subject, problems, and the shapes of all bodies.

mod schemas;

use super::home::POLICY;
use super::openapi;
use super::problem::Kind;
use axum::http::header;
use axum::response::{Html, IntoResponse, Response};
use serde_json::Value;
use std::sync::LazyLock;

/// Read the description as a page.
#[utoipa::path(
    get, path = "/docs", operation_id = "get_docs", tag = "service",
    responses((status = 200, description = "This description, to be read by people", content_type = "text/html", body = String))
)]
pub(super) async fn page() -> Response {
    static PAGE: LazyLock<String> = LazyLock::new(|| write(&openapi::description()));
    ([(header::CONTENT_SECURITY_POLICY, POLICY)], Html(PAGE.as_str())).into_response()
}

/// Text as it may stand in HTML, also within an attribute.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Text in which what stands between backquotes is code, and an empty line parts paragraphs.
fn prose(text: &str) -> String {
    let paragraph = |text: &str| {
        let parts = escape(text);
        let parts = parts.split('`').enumerate();
        parts.map(|(i, part)| if i % 2 == 1 { format!("<code>{part}</code>") } else { part.to_owned() }).collect()
    };
    let paragraphs: Vec<String> = text.split("\n\n").map(paragraph).collect();
    paragraphs.join("<br>")
}

fn text<'v>(value: &'v Value, member: &str) -> &'v str {
    value[member].as_str().unwrap_or_default()
}

fn items(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

fn members(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flatten()
}

fn write(document: &Value) -> String {
    let tags: Vec<&str> = items(&document["tags"]).map(|tag| text(tag, "name")).collect();
    let links: String = tags.iter().map(|&tag| format!("<li><a href=\"#tag-{0}\">{0}</a></li>", escape(tag))).collect();
    let subjects: String = items(&document["tags"]).map(|tag| subject(document, tag)).collect();
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title} {version}: interface</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<header>\n<h1>{title} <small>{version}</small></h1>\n<p>{description}</p>\n\
         <p>The same for programs: <a href=\"/openapi.yaml\">/openapi.yaml</a>.</p>\n<nav aria-label=\"Subjects\"><ul>{links}\
         <li><a href=\"#problems\">problems</a></li><li><a href=\"#schemas\">schemas</a></li></ul></nav>\n</header>\n<main>\n\
         {subjects}{problems}{schemas}</main>\n</body>\n</html>\n",
        title = escape(text(&document["info"], "title")),
        version = escape(text(&document["info"], "version")),
        description = prose(text(&document["info"], "description")),
        problems = problems(),
        schemas = schemas::all(&document["components"]["schemas"]),
    )
}

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
        table("Parameters", &["Name", "Where", "What", "Meaning"], &parameters),
        table("Answers", &["Status", "When", "Body", "Headers"], &responses),
    )
}

/// Media types and what they hold.
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

/// A table of rows whose cells are written; nothing where there are none.
fn table(caption: &str, columns: &[&str], rows: &[String]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let head: String = columns.iter().map(|column| format!("<th scope=\"col\">{column}</th>")).collect();
    let rows: String = rows.iter().map(|row| format!("<tr>{row}</tr>\n")).collect();
    format!(
        "<div class=\"wide\" tabindex=\"0\" role=\"group\" aria-label=\"{caption}\"><table>\n<caption>{caption}</caption>\n\
         <thead><tr>{head}</tr></thead>\n<tbody>\n{rows}</tbody>\n</table></div>\n"
    )
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
        prose("Every error answer is a `Problem` whose `type` is `urn:oviduct:problem:` and one of these."),
        table("Problems", &["Type", "Status", "Title"], &rows),
    )
}

#[cfg(test)]
mod tests;
