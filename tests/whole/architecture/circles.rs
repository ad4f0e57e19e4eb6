//! Finds circles of imports: file A names an item that file B defines, and B names an item of A,
//! directly or through other files.
//!
//! An arrow leads from the file that names an item to the file that *defines* it. The form of the
//! path does not matter: `crate::`, `super::`, an imported module, a glob, or a re-export.
//!
//! - A facade is not a circle. A parent that only declares its children and re-exports their items
//!   has no arrow to them. A child that imports an item of its sibling through the parent has an
//!   arrow to the sibling.
//! - A parent whose own code names an item of a child has an arrow to the child. If the child names
//!   an item that the parent defines, the two form a circle.
//! - Method calls and members of traits give no arrow, because the text shows no types. A child may
//!   therefore contain `impl` blocks of its parent's type, unless the parent names the child.

use super::source::{Source, words};
use std::collections::{BTreeMap, BTreeSet};

type Path = Vec<String>;

/// Name that `use` binds in a module; a glob has none.
struct Binding {
    name: Option<String>,
    path: Path,
    public: bool,
}

struct Module {
    file: String,
    bindings: Vec<Binding>,
    /// Names that follow a keyword such as `fn` or `struct`, at any depth.
    defined: BTreeSet<String>,
    /// The code without `use`, without `mod name;`, and without the scope of `pub(…)`.
    body: String,
}

#[derive(Clone, PartialEq, Eq)]
enum Target {
    Module(Path),
    /// An item that the module at this path defines.
    Item(Path),
}

/// The modules of a crate by path, one per file.
struct Modules(BTreeMap<Path, Module>);

/// Pairs of a file and a file that it names, with the names.
pub(crate) type Arrows = BTreeMap<(String, String), BTreeSet<String>>;

/// The arrows between the files of a crate.
pub(crate) fn arrows(sources: &[Source]) -> Arrows {
    let read = |source: &Source| (source.module_path().into_iter().map(str::to_owned).collect(), Module::read(source));
    let modules = Modules(sources.iter().filter(|source| source.path != "main.rs").map(read).collect());
    let mut arrows = Arrows::new();
    for (at, module) in &modules.0 {
        for (to, name) in modules.named(at, module) {
            if to != *at {
                arrows.entry((module.file.clone(), modules.0[&to].file.clone())).or_default().insert(name);
            }
        }
    }
    arrows
}

/// Circles among the arrows: for each set of files that reach each other, the arrows between them.
pub(crate) fn circles(arrows: &Arrows) -> Vec<Arrows> {
    let mut next: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (from, to) in arrows.keys() {
        next.entry(from).or_default().push(to);
    }
    let reached = |start: &str| {
        let (mut seen, mut stack) = (BTreeSet::new(), vec![start.to_owned()]);
        while let Some(at) = stack.pop() {
            for to in next.get(at.as_str()).into_iter().flatten() {
                if seen.insert((*to).to_owned()) {
                    stack.push((*to).to_owned());
                }
            }
        }
        seen
    };
    let reach: BTreeMap<&str, BTreeSet<String>> = next.keys().map(|&file| (file, reached(file))).collect();
    let mut placed = BTreeSet::new();
    let mut circles = Vec::new();
    for (&file, far) in &reach {
        let back = |other: &str| far.contains(other) && reach.get(other).is_some_and(|theirs| theirs.contains(file));
        if back(file) && !placed.contains(file) {
            let inside = arrows.iter().filter(|((from, to), _)| back(from) && back(to));
            let circle: Arrows = inside.map(|(arrow, names)| (arrow.clone(), names.clone())).collect();
            placed.extend(circle.keys().map(|(from, _)| from.clone()));
            circles.push(circle);
        }
    }
    circles
}

impl Module {
    fn read(source: &Source) -> Self {
        const KEYWORDS: [&str; 9] =
            ["fn", "struct", "enum", "union", "trait", "type", "const", "static", "macro_rules"];
        let (mut bindings, mut body) = (Vec::new(), String::new());
        let mut rest = without_scopes(&source.code);
        while let Some((begin, end, public)) = next_use(&rest) {
            body.push_str(&rest[..begin]);
            body.push(';');
            expand(&rest[begin + "use".len()..end], &[], public, &mut bindings);
            rest = rest.split_off(end + 1);
        }
        body.push_str(&rest);
        let body = without_declarations(&body);
        let all: Vec<&str> = words(&body).map(|(_, word)| word).collect();
        let defined =
            all.windows(2).filter(|pair| KEYWORDS.contains(&pair[0])).map(|pair| pair[1].to_owned()).collect();
        Self { file: source.path.clone(), bindings, defined, body }
    }

    /// Paths in the code, of one or more names, except names after a dot.
    fn paths(&self) -> impl Iterator<Item = Path> {
        let code = &self.body;
        let mut all = words(code).peekable();
        std::iter::from_fn(move || {
            let (start, word) = all.next()?;
            let (mut path, mut end) = (vec![word.to_owned()], start + word.len());
            while let Some(&(at, word)) = all.peek()
                && &code[end..at] == "::"
            {
                path.push(word.to_owned());
                end = at + word.len();
                all.next();
            }
            let before = code[..start].trim_end();
            let is_member = before.ends_with('.') && !before.ends_with("..") || before.ends_with("::");
            Some(if is_member { Path::new() } else { path })
        })
        .filter(|path| !path.is_empty())
    }
}

impl Modules {
    /// Modules whose items a module names, with the names.
    fn named(&self, at: &Path, module: &Module) -> Vec<(Path, String)> {
        let paths: Vec<Path> = module.paths().collect();
        let first: BTreeSet<&str> = paths.iter().map(|path| path[0].as_str()).collect();
        let mut found = Vec::new();
        let mut add = |targets: Vec<Target>, name: &str| {
            for target in targets {
                if let Target::Item(to) = target {
                    found.push((to, name.to_owned()));
                }
            }
        };
        for binding in &module.bindings {
            let targets = self.resolve(at, &binding.path, 0);
            match &binding.name {
                Some(name) => {
                    let below = |target: &Target| matches!(target, Target::Item(to) if to.starts_with(at) && to != at);
                    let facade = binding.public && targets.iter().all(below) && !first.contains(name.as_str());
                    if !facade {
                        add(targets, name);
                    }
                }
                None => {
                    for target in targets {
                        if let Target::Module(from) = target {
                            first.iter().for_each(|name| add(self.exported(&from, name, 0), name));
                        }
                    }
                }
            }
        }
        for path in paths.iter().filter(|path| path.len() > 1) {
            // `Type::function`: the other file defines the type.
            let item = path.iter().find(|name| name.starts_with(char::is_uppercase)).or(path.last());
            add(self.resolve(at, path, 0), item.map_or("", String::as_str));
        }
        found
    }

    /// Targets of a path in the module `at`.
    fn resolve(&self, at: &Path, path: &[String], depth: usize) -> Vec<Target> {
        let Some((head, rest)) = path.split_first() else { return Vec::new() };
        let start = match head.as_str() {
            "crate" => vec![Target::Module(Path::new())],
            "self" => vec![Target::Module(at.clone())],
            "super" => vec![Target::Module(above(at))],
            name => self.exported(at, name, depth),
        };
        self.follow(start, rest, depth)
    }

    /// Targets of the rest of a path that begins at these targets.
    fn follow(&self, start: Vec<Target>, rest: &[String], depth: usize) -> Vec<Target> {
        rest.iter().fold(start, |targets, name| {
            let inside = |target| match target {
                Target::Module(at) if name == "super" => vec![Target::Module(above(&at))],
                Target::Module(at) => {
                    let found = self.exported(&at, name, depth);
                    if found.is_empty() { vec![Target::Item(at)] } else { found }
                }
                // The name after an item is its variant or function.
                item @ Target::Item(_) => vec![item],
            };
            targets.into_iter().flat_map(inside).collect()
        })
    }

    /// Targets of a name inside a module; empty if the text of the module does not show them.
    fn exported(&self, at: &Path, name: &str, depth: usize) -> Vec<Target> {
        const DEEPEST: usize = 16;
        let Some(module) = self.0.get(at).filter(|_| depth < DEEPEST) else { return Vec::new() };
        let child: Path = at.iter().cloned().chain([name.to_owned()]).collect();
        let child = self.0.contains_key(&child).then_some(Target::Module(child));
        let mut found: Vec<Target> = child.iter().cloned().collect();
        for binding in module.bindings.iter().filter(|binding| binding.name.as_deref() == Some(name)) {
            found.extend(match (&binding.path[..], &child) {
                // `pub(super) use m` exports a macro under its own name.
                ([own], _) if own == name => Vec::new(),
                // `use loft::loft` next to `mod loft`.
                ([head, rest @ ..], Some(child)) if head == name => self.follow(vec![child.clone()], rest, depth + 1),
                (path, _) => self.resolve(at, path, depth + 1),
            });
        }
        if found.is_empty() && module.defined.contains(name) {
            found.push(Target::Item(at.clone()));
        }
        if found.is_empty() {
            for glob in module.bindings.iter().filter(|binding| binding.name.is_none()) {
                for target in self.resolve(at, &glob.path, depth + 1) {
                    if let Target::Module(from) = target {
                        found.extend(self.exported(&from, name, depth + 1));
                    }
                }
            }
        }
        found
    }
}

fn above(at: &Path) -> Path {
    at.split_last().map(|(_, above)| above.to_vec()).unwrap_or_default()
}

/// Removes the scope of `pub(…)`, which is a path but not an import.
fn without_scopes(code: &str) -> String {
    let mut parts = code.split("pub(");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        out.push_str("pub");
        out.push_str(part.split_once(')').map_or(part, |(_, after)| after));
    }
    out
}

/// Removes `mod name;`.
fn without_declarations(code: &str) -> String {
    code.split_inclusive(';')
        .map(|statement| {
            let last: Vec<&str> = statement.trim_end_matches(';').rsplitn(3, char::is_whitespace).collect();
            match last[..] {
                [_, "mod", before] => before,
                [_, "mod"] => "",
                _ => statement,
            }
        })
        .collect()
}

/// The next `use` statement: position of its beginning and of its semicolon; true if it is `pub`.
fn next_use(code: &str) -> Option<(usize, usize, bool)> {
    words(code).find_map(|(at, word)| {
        let before = code[..at].trim_end();
        let public = before.ends_with("pub");
        let begins = public || before.is_empty() || before.ends_with([';', '{', '}', ']']);
        // `use<'a>` in a type is not a statement.
        let is_statement = word == "use" && begins && code[at + word.len()..].starts_with(char::is_whitespace);
        let end = at + code[at..].find(';')?;
        is_statement.then_some((at, end, public))
    })
}

/// The paths that a `use` tree binds.
fn expand(tree: &str, prefix: &[String], public: bool, bindings: &mut Vec<Binding>) {
    let tree = tree.trim();
    if let Some((head, group)) = tree.split_once('{') {
        let prefix: Path = prefix.iter().cloned().chain(words(head).map(|(_, word)| word.to_owned())).collect();
        let (mut depth, mut start) = (0, 0);
        for (i, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth > 0 => depth -= 1,
                ',' | '}' if depth == 0 => {
                    expand(&group[start..i], &prefix, public, bindings);
                    start = i + 1;
                    if c == '}' {
                        break;
                    }
                }
                _ => {}
            }
        }
        return;
    }
    let (path, alias) = tree.split_once(" as ").map_or((tree, None), |(path, alias)| (path, Some(alias.trim())));
    let mut path: Path = prefix.iter().cloned().chain(words(path).map(|(_, word)| word.to_owned())).collect();
    let glob = tree.ends_with('*');
    if !glob && path.len() > 1 && path.last().is_some_and(|last| last == "self") {
        path.pop();
    }
    let name = if glob { None } else { alias.or(path.last().map(String::as_str)).map(str::to_owned) };
    if tree.is_empty() || name.is_none() && !glob {
        return;
    }
    bindings.push(Binding { name, path, public });
}
