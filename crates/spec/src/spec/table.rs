//! Types and macros of the parameter table. A group of parameters is declared once, with titles,
//! units, bounds and documentation; its struct, reader, canonical JSON and JSON Schema are
//! generated.

use super::bounds::{Count, Range};
use super::fault::child;
use super::reader::{JsonReader, Site};
use serde_json::Value;

/// A parameter or a group of parameters in the table.
#[derive(Clone, Debug)]
pub(super) struct Field {
    /// Name in JSON.
    pub(super) name: &'static str,
    /// Name for display.
    pub(super) title: &'static str,
    /// Unit; empty if there is none.
    pub(super) unit: &'static str,
    /// Description, from the doc comment of the field.
    pub(super) doc: &'static str,
    /// Type and bounds of the value.
    pub(super) kind: Kind,
}

/// Type and bounds of a value.
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
    /// One of several names. Each is paired with its documentation.
    Choice(&'static [(&'static str, &'static str)]),
    /// A Boolean.
    Bool,
    /// A list of points: number of coordinates, and their bounds.
    Points(usize, Range),
    /// A square grid of numbers, as rows, with their bounds.
    Grid(Range),
}

/// A type that can be the value of a parameter.
pub(super) trait Parameter: Sized {
    /// Type of the last column in the table, such as bounds.
    type Rule: Copy;
    /// True if the type is a group of parameters.
    const GROUP: bool = false;

    /// Describes the type for the table.
    fn kind(rule: Self::Rule) -> Kind;
    /// Reads a value and records all faults. Returns `None` exactly if there is a fault.
    fn read(reader: &mut JsonReader, site: Site<'_>, value: &Value, rule: Self::Rule) -> Option<Self>;
    /// Canonical JSON of the value.
    fn write(&self) -> Value;
}

/// Reads member `name` of a group.
pub(super) fn member<T: Parameter>(
    reader: &mut JsonReader,
    group: Site<'_>,
    value: &Value,
    name: &str,
    unit: &str,
    rule: T::Rule,
) -> Option<T> {
    let at = child(group.at, name);
    let read = match value.get(name) {
        Some(value) => T::read(reader, Site { at: &at, unit }, value, rule),
        None => reader.fault(&at, "is missing"),
    };
    if read.is_none() && !T::GROUP {
        reader.bad.push(at);
    }
    read
}

/// Declares a group of parameters. A field is `name: Type = "Title" ["unit"] rule;` with a doc
/// comment.
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
                reader: &mut $crate::spec::reader::JsonReader,
                site: $crate::spec::reader::Site<'_>,
                value: &serde_json::Value,
                (): (),
            ) -> Option<Self> {
                $( let $field = $crate::spec::table::member::<$Type>(reader, site, value, stringify!($field), $unit, $rule); )+
                Some(Self { $( $field: $field? ),+ })
            }

            fn write(&self) -> serde_json::Value {
                let members = [ $( (stringify!($field).to_owned(), $crate::spec::table::Parameter::write(&self.$field)) ),+ ];
                serde_json::Value::Object(members.into_iter().collect())
            }
        }
    };
}

/// Declares a choice between names. A variant is `Variant = "name",` with a doc comment.
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

            /// Name in JSON.
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
                reader: &mut $crate::spec::reader::JsonReader,
                site: $crate::spec::reader::Site<'_>,
                value: &serde_json::Value,
                (): (),
            ) -> Option<Self> {
                match value.as_str() {
                    $( Some($name) => Some(Self::$Variant), )+
                    _ => reader.not_a_choice(site.at, value, &[ $($name),+ ]),
                }
            }

            fn write(&self) -> serde_json::Value {
                self.name().into()
            }
        }
    };
}

pub(super) use {choice, group};
