//! Expressions of measures: a small language with a recursive-descent parser.
//!
//! ```text
//! sum     = product { ("+" | "-") product }
//! product = factor { ("*" | "/") factor }
//! factor  = number | "(" sum ")"
//!         | QUANTITY "@" place              mean of a quantity at a place
//!         | "tube." NAME                    measure of the whole tube
//!         | "spec(" POINTER ")"             value of the model's specification
//!         | "preset(" NAME "," POINTER ")"  value of the specification of a preset
//!         | "falling(" sum { "," sum } ")"  smallest relative fall from one value to the next
//!         | "least_at(" QUANTITY "," N ")"  place of the n-th part of the tube with the least mean
//! place   = REGION | number ".." number     parts of the length from the uterine end
//! ```

/// Expression of measures.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Expression {
    /// A number.
    Number(f64),
    /// Mean of a quantity at a place.
    At(String, Place),
    /// Measure of the whole tube.
    Tube(String),
    /// Value at a JSON pointer of the specification of the model, or of a preset.
    Parameter(Option<String>, String),
    /// Two expressions and an operator.
    Binary(Box<Self>, Operator, Box<Self>),
    /// Smallest relative fall from one value to the next.
    Falling(Vec<Self>),
    /// Middle of the part of the tube with the smallest mean of a quantity, of so many equal parts.
    LeastAt(String, u32),
}

/// Arithmetic operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Operator {
    Add,
    Subtract,
    Multiply,
    Divide,
}

/// Place along the tube.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Place {
    /// A region of the report.
    Region(String),
    /// A range of parts of the length, from the uterine end.
    Parts([f64; 2]),
}

impl Expression {
    /// Parses an expression. The error names the unexpected text.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let mut parser = Parser { rest: text };
        let expression = parser.sum()?;
        parser.skip();
        if parser.rest.is_empty() { Ok(expression) } else { Err(parser.unexpected("the end")) }
    }

    /// True if the expression contains this measure of the whole tube.
    pub(super) fn uses_tube(&self, name: &str) -> bool {
        match self {
            Self::Tube(own) => own == name,
            Self::Binary(a, _, b) => a.uses_tube(name) || b.uses_tube(name),
            Self::Falling(all) => all.iter().any(|one| one.uses_tube(name)),
            Self::Number(_) | Self::At(..) | Self::Parameter(..) | Self::LeastAt(..) => false,
        }
    }

    /// Quantities of sections that the expression contains.
    #[cfg(test)]
    pub(super) fn quantities(&self) -> Vec<&str> {
        match self {
            Self::At(quantity, _) | Self::LeastAt(quantity, _) => vec![quantity],
            Self::Binary(a, _, b) => [a.quantities(), b.quantities()].concat(),
            Self::Falling(all) => all.iter().flat_map(Self::quantities).collect(),
            Self::Number(_) | Self::Tube(_) | Self::Parameter(..) => Vec::new(),
        }
    }
}

struct Parser<'a> {
    rest: &'a str,
}

impl<'a> Parser<'a> {
    fn skip(&mut self) {
        self.rest = self.rest.trim_start();
    }

    fn unexpected(&self, expected: &str) -> String {
        format!("{expected} is expected at `{}`", self.rest)
    }

    /// Consumes a token if it comes next.
    fn takes(&mut self, token: &str) -> bool {
        self.skip();
        let after = self.rest.strip_prefix(token);
        self.rest = after.unwrap_or(self.rest);
        after.is_some()
    }

    fn expect(&mut self, token: &str) -> Result<(), String> {
        if self.takes(token) { Ok(()) } else { Err(self.unexpected(token)) }
    }

    /// Consumes the characters that match.
    fn run(&mut self, matches: impl Fn(char) -> bool) -> &'a str {
        let end = self.rest.find(|c| !matches(c)).unwrap_or(self.rest.len());
        let (run, rest) = self.rest.split_at(end);
        self.rest = rest;
        run
    }

    fn name(&mut self) -> Result<String, String> {
        self.skip();
        let name = self.run(|c| c.is_ascii_alphanumeric() || c == '_');
        if name.is_empty() { Err(self.unexpected("a name")) } else { Ok(name.to_owned()) }
    }

    /// A decimal number. Two points in a row end it, because they separate the ends of a range.
    fn number(&mut self) -> Result<f64, String> {
        self.skip();
        let digits = |text: &str| text.bytes().take_while(u8::is_ascii_digit).count();
        let whole = digits(self.rest);
        let fraction = self.rest[whole..].strip_prefix('.').map_or(0, digits);
        let length = if fraction > 0 { whole + 1 + fraction } else { whole };
        let (number, rest) = self.rest.split_at(length);
        let number = number.parse().map_err(|_| self.unexpected("a number"))?;
        self.rest = rest;
        Ok(number)
    }

    fn sum(&mut self) -> Result<Expression, String> {
        self.chain(&[("+", Operator::Add), ("-", Operator::Subtract)], Self::product)
    }

    fn product(&mut self) -> Result<Expression, String> {
        self.chain(&[("*", Operator::Multiply), ("/", Operator::Divide)], Self::factor)
    }

    fn chain(
        &mut self,
        operators: &[(&str, Operator)],
        part: fn(&mut Self) -> Result<Expression, String>,
    ) -> Result<Expression, String> {
        let mut left = part(self)?;
        while let Some(&(_, operator)) = operators.iter().find(|(token, _)| self.takes(token)) {
            left = Expression::Binary(Box::new(left), operator, Box::new(part(self)?));
        }
        Ok(left)
    }

    fn factor(&mut self) -> Result<Expression, String> {
        if self.takes("(") {
            let inner = self.sum()?;
            self.expect(")")?;
            return Ok(inner);
        }
        if self.rest.starts_with(|c: char| c.is_ascii_digit()) {
            return Ok(Expression::Number(self.number()?));
        }
        let name = self.name()?;
        if self.takes("@") {
            return Ok(Expression::At(name, self.place()?));
        }
        if name == "tube" {
            self.expect(".")?;
            return Ok(Expression::Tube(self.name()?));
        }
        self.expect("(")?;
        let inner = match name.as_str() {
            "spec" => Expression::Parameter(None, self.raw()?),
            "preset" => {
                let preset = self.raw()?;
                self.expect(",")?;
                Expression::Parameter(Some(preset), self.raw()?)
            }
            "falling" => {
                let mut all = vec![self.sum()?];
                self.expect(",")?;
                all.push(self.sum()?);
                while self.takes(",") {
                    all.push(self.sum()?);
                }
                Expression::Falling(all)
            }
            "least_at" => {
                let quantity = self.name()?;
                self.expect(",")?;
                let parts = self.number()?;
                if parts < 2.0 || parts.fract() != 0.0 {
                    return Err(format!("least_at needs a whole number of parts from 2, not {parts}"));
                }
                Expression::LeastAt(quantity, parts as u32)
            }
            other => return Err(format!("{other} is no function")),
        };
        self.expect(")")?;
        Ok(inner)
    }

    /// Name of a preset or a JSON pointer: all text up to a comma or the closing parenthesis.
    fn raw(&mut self) -> Result<String, String> {
        self.skip();
        let raw = self.run(|c| c != ',' && c != ')').trim_end();
        if raw.is_empty() { Err(self.unexpected("a name or pointer")) } else { Ok(raw.to_owned()) }
    }

    fn place(&mut self) -> Result<Place, String> {
        self.skip();
        if !self.rest.starts_with(|c: char| c.is_ascii_digit()) {
            return Ok(Place::Region(self.name()?));
        }
        let from = self.number()?;
        self.expect("..")?;
        let to = self.number()?;
        if from < to && to <= 1.0 {
            Ok(Place::Parts([from, to]))
        } else {
            Err(format!("{from}..{to} is no range of parts of the length"))
        }
    }
}
