//! The machinery of the parameter table: a group of parameters is written once, with titles, units, bounds
//! and documentation, and from that come its struct, its reader, its canonical JSON and its JSON Schema.

use super::read::{Reader, Site};
use serde_json::Value;

/// A parameter, or a group of them, as the table describes it.
#[derive(Clone, Debug)]
pub(super) struct Field {
    /// Name in JSON.
    pub(super) name: &'static str,
    /// Name for people.
    pub(super) title: &'static str,
    /// Unit; empty where there is none.
    pub(super) unit: &'static str,
    /// What it is: the documentation of the struct's field.
    pub(super) doc: &'static str,
    /// What values it takes.
    pub(super) kind: Kind,
}

/// What values a parameter takes.
#[derive(Clone, Debug)]
pub(super) enum Kind {
    /// An object of parameters.
    Group(Vec<Field>),
    /// A number that may change along the tube.
    Schedule(Range),
    /// A number.
    Number(Range),
    /// An integer.
    Integer(Count),
    /// One of a few names, each with its documentation.
    Choice(&'static [(&'static str, &'static str)]),
    /// Yes or no.
    Bool,
}

/// Closed bounds of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Range {
    pub(super) min: f64,
    pub(super) max: f64,
    /// Why the upper bound is where it is, where that is not plain.
    pub(super) because: Option<&'static str>,
    /// Whether a schedule must be without fluctuation.
    pub(super) steady: bool,
}

impl Range {
    /// From `min` to `max`, both allowed.
    pub(super) const fn of(min: f64, max: f64) -> Self {
        Self { min, max, because: None, steady: false }
    }

    /// Forbids a fluctuation.
    pub(super) const fn steady(mut self) -> Self {
        self.steady = true;
        self
    }

    /// Gives the reason for the upper bound.
    pub(super) const fn because(mut self, reason: &'static str) -> Self {
        self.because = Some(reason);
        self
    }
}

/// Closed bounds of an integer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Count {
    pub(super) min: u32,
    pub(super) max: u32,
}

impl Count {
    /// From `min` to `max`, both allowed.
    pub(super) const fn of(min: u32, max: u32) -> Self {
        Self { min, max }
    }
}

/// A type that can be the value of a parameter.
pub(super) trait Parameter: Sized {
    /// What its row of the table must give.
    type Rule: Copy;
    /// Whether it is a group of parameters.
    const GROUP: bool = false;

    /// How the table describes it.
    fn kind(rule: Self::Rule) -> Kind;
    /// Reads it, naming every fault; `None` exactly where there was one.
    fn read(reader: &mut Reader, site: Site<'_>, value: &Value, rule: Self::Rule) -> Option<Self>;
    /// Its canonical JSON.
    fn write(&self) -> Value;
}

/// Writes down a group of parameters: `name: Type = "Title" ["unit"] rule;`, documented as usual.
macro_rules! group {
    (
        $(#[doc = $about:literal])+
        #[derive($($derive:ident),+)]
        pub struct $Name:ident {
            $(
                $(#[doc = $doc:literal])+
                pub $field:ident: $Type:ty = $title:literal [$unit:literal] $rule:expr;
            )+
        }
    ) => {
        $(#[doc = $about])+
        #[derive($($derive),+)]
        pub struct $Name {
            $( $(#[doc = $doc])+ pub $field: $Type, )+
        }

        impl $crate::spec::table::Parameter for $Name {
            type Rule = ();
            const GROUP: bool = true;

            fn kind((): ()) -> $crate::spec::table::Kind {
                $crate::spec::table::Kind::Group(vec![ $( $crate::spec::table::Field {
                    name: stringify!($field),
                    title: $title,
                    unit: $unit,
                    doc: concat!($($doc),+).trim_ascii(),
                    kind: <$Type as $crate::spec::table::Parameter>::kind($rule),
                } ),+ ])
            }

            fn read(
                reader: &mut $crate::spec::read::Reader,
                site: $crate::spec::read::Site<'_>,
                value: &serde_json::Value,
                (): (),
            ) -> Option<Self> {
                $( let $field = reader.member::<$Type>(site, value, stringify!($field), $unit, $rule); )+
                Some(Self { $( $field: $field? ),+ })
            }

            fn write(&self) -> serde_json::Value {
                let members = [ $( (stringify!($field).to_owned(), $crate::spec::table::Parameter::write(&self.$field)) ),+ ];
                serde_json::Value::Object(members.into_iter().collect())
            }
        }
    };
}

/// Writes down a choice between names: `Variant = "name",`, documented as usual.
macro_rules! choice {
    (
        $(#[doc = $about:literal])+
        #[derive($($derive:ident),+)]
        pub enum $Name:ident {
            $( $(#[doc = $doc:literal])+ $(#[$marker:ident])? $Variant:ident = $name:literal, )+
        }
    ) => {
        $(#[doc = $about])+
        #[derive($($derive),+)]
        pub enum $Name {
            $( $(#[doc = $doc])+ $(#[$marker])? $Variant, )+
        }

        impl $Name {
            pub(super) const NAMES: &'static [(&'static str, &'static str)] =
                &[ $( ($name, concat!($($doc),+).trim_ascii()) ),+ ];

            /// Its name in JSON.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $( Self::$Variant => $name, )+ }
            }
        }

        impl $crate::spec::table::Parameter for $Name {
            type Rule = ();

            fn kind((): ()) -> $crate::spec::table::Kind {
                $crate::spec::table::Kind::Choice(Self::NAMES)
            }

            fn read(
                reader: &mut $crate::spec::read::Reader,
                site: $crate::spec::read::Site<'_>,
                value: &serde_json::Value,
                (): (),
            ) -> Option<Self> {
                match value.as_str() {
                    $( Some($name) => Some(Self::$Variant), )+
                    _ => reader.not_a_choice(site, value, Self::NAMES),
                }
            }

            fn write(&self) -> serde_json::Value {
                self.name().into()
            }
        }
    };
}

pub(super) use {choice, group};
