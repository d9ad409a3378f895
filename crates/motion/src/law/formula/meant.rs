//! What was meant by what no formula has: operators and spellings of other languages, missing signs, units.

use super::FormulaError;
use super::parse::POINT;
use super::parse::{DEGREES, MINUS, Parser, SUPERSCRIPTS, begins_name, first_word, is_of_name};
use super::tree::{Span, error};
use super::words::{self, CONSTANTS, FUNCTIONS, LIST};

/// Characters of a formula that a message repeats, at most.
const MOST_REPEATED: usize = 40;

/// That a unit stands in a formula.
fn unit_in_formula(span: Span, number: &str, unit: &str) -> FormulaError {
    let help = format!(
        "give the quantity a name: where = {{ x = \"{number} {unit}\" }}, and write `x` in the formula; a bare number has the motion's unit"
    );
    error(span, format!("`{unit}` is a unit, and a formula has none")).helped(help)
}

/// `π*t` for `πt`: a name that begins with a Greek constant is most likely a product.
fn parted(name: &str) -> Option<String> {
    let rest = name.strip_prefix(['π', 'τ']).filter(|rest| rest.starts_with(begins_name))?;
    Some(format!("{}*{rest}", &name[..name.len() - rest.len()]))
}

impl<'a> Parser<'a> {
    fn quoted(&self, from: usize, to: usize) -> &'a str {
        let text = self.text.get(from..to).unwrap_or_default().trim();
        text.char_indices().nth(MOST_REPEATED).map_or(text, |(end, _)| &text[..end])
    }

    /// What comes next, up to where it cannot be one product any more.
    fn product_ahead(&self) -> &'a str {
        let rest = self.rest();
        let mut depth = 0_usize;
        let end = rest.find(|c| {
            let is_end = depth == 0 && matches!(c, ')' | ',' | '+' | '<' | '>' | '=' | '?' | ';');
            match c {
                '(' => depth += 1,
                ')' => depth = depth.saturating_sub(1),
                _ => {}
            }
            is_end
        });
        rest[..end.unwrap_or(rest.len())].trim()
    }

    /// The brackets that come next, with what is in them.
    fn brackets_ahead(&self) -> Option<&'a str> {
        let rest = self.rest().trim_start();
        let mut depth = 0_usize;
        for (at, c) in rest.char_indices() {
            match c {
                '(' => depth += 1,
                ')' => depth = depth.saturating_sub(1),
                _ => {}
            }
            if depth == 0 {
                return rest[..at].starts_with('(').then(|| &rest[..at + 1]);
            }
        }
        None
    }

    /// That something else should come next.
    pub(super) fn unexpected(&mut self, message: &str) -> FormulaError {
        let here = self.here();
        let rest = self.rest();
        let left = self.quoted(0, here.0);
        let at = |length: usize| (here.0, length);
        match rest.chars().next() {
            Some('?') => error(here, "a choice is written with if")
                .helped(format!("write `if({left}, a, b)` in place of `{left} ? a : b`")),
            Some(',') if self.is_decimal_comma(here.0) => error(here, message).helped(POINT),
            Some(')') => {
                error(here, "this bracket closes nothing").helped("take it out, or add the `(` that is missing")
            }
            Some('[' | ']' | '{' | '}') => error(here, "formulas have round brackets only").helped("write `(` and `)`"),
            Some('!') => {
                error(here, "there is no factorial").helped("write its number, such as 6 for 3!; for `not` write `not`")
            }
            Some('|') => {
                error(here, "`|` is no operator").helped("for a magnitude write `abs(x)`, for conditions `or`")
            }
            Some('&') => error(here, "`&` is no operator").helped("write `and`"),
            Some('±' | '∓') => {
                error(here, "a law is one position at a time").helped("write `+` or `-`; for both, two motions")
            }
            Some(';') => error(here, message).helped("arguments are separated by `,`; a formula is one expression"),
            Some(':') => error(here, message).helped("a choice is written `if(condition, a, b)`"),
            Some('"' | '\'' | '`') => error(here, "a formula has no quotes")
                .helped("a quantity with its unit is a parameter, as in where = { phi = \"90 deg\" }"),
            Some('\\') => error(here, "this is LaTeX").helped("write `sin(x)`, `pi`, `a/b`, `sqrt(x)`"),
            Some(c) if c.is_ascii_digit() && self.text[..here.0].trim_end().ends_with(')') => {
                let number = &rest[..rest.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(rest.len())];
                error(at(number.len()), format!("a `*` is missing here: write `(…)*{number}`"))
            }
            _ => error(here, message),
        }
    }

    /// That there is no number, name or bracket where one must be.
    pub(super) fn no_operand(&mut self) -> FormulaError {
        let here = self.here();
        let rest = self.rest();
        let before = self.text[..here.0].trim_end();
        let plain = |message: &str| error(here, message);
        match rest.chars().next() {
            None if before.ends_with('(') => error((before.len() - 1, 1), "this bracket is never closed"),
            None => plain("a number, a name or a bracket is expected here").helped("the formula ends too early"),
            Some('√') => plain("a root is written with sqrt").helped("write `sqrt(x)`"),
            Some('∛') => plain("a cube root is a power").helped("write `x^(1/3)`, for x above 0"),
            Some('∞') => plain("a position is a finite number"),
            Some('∑' | 'Σ' | '∏' | '∫' | '∂') => {
                plain("a formula has no sums, products or integrals over an index").helped("write the terms one by one")
            }
            Some('½') => plain("a fraction is written with `/`").helped("write `0.5`"),
            Some('¼') => plain("a fraction is written with `/`").helped("write `0.25`"),
            Some('¾') => plain("a fraction is written with `/`").helped("write `0.75`"),
            Some('|') => plain("a magnitude is written with abs").helped("write `abs(x)` for `|x|`"),
            Some('=') if before.ends_with(['<', '>', '=', '!']) || before.is_empty() => {
                plain("nothing stands left of `=`").helped("write the position alone: `90*sin(2*pi*t)`")
            }
            Some('$' | '@' | '#') => plain("a parameter is a plain name").helped("write `a`, with where = { a = 3 }"),
            Some('*') if before.ends_with('*') => plain("a power is written `^`, or `**` without a blank"),
            Some(')') if before.ends_with('(') => plain("these brackets are empty"),
            Some(')') if before.ends_with(',') => plain("an argument is missing before `)`"),
            Some(',') if before.ends_with('(') || before.ends_with(',') => plain("an argument is missing before `,`"),
            Some('[' | ']' | '{' | '}' | '"' | '\'' | '`' | '\\') => self.unexpected(""),
            _ => plain("a number, a name or a bracket is expected here"),
        }
    }

    /// Refuses other languages' operators between a term and the next.
    pub(super) fn no_foreign_operator(&mut self) -> Result<(), FormulaError> {
        let here = self.here();
        let rest = self.rest();
        if rest.starts_with("//") {
            return Err(error((here.0, 2), "`//` is no operator").helped("write `floor(a/b)`"));
        }
        if let Some(behind) = rest.strip_prefix('%') {
            // A percentage, if nothing follows that could be divided by.
            let is_modulo = behind.trim_start().starts_with(|c: char| is_of_name(c) || matches!(c, '(' | '.'));
            let left = self.quoted(self.term_before(here.0), here.0);
            let (what, help) = match left.parse::<f64>() {
                Ok(percents) if !is_modulo => ("a formula has no percents", format!("write `{}`", percents / 100.0)),
                _ if is_modulo => (
                    "`%` is no operator",
                    format!("write `mod({left}, …)`, which is never negative for a positive divisor"),
                ),
                _ => ("a formula has no percents", "write `/100`".to_owned()),
            };
            return Err(error((here.0, 1), what).helped(help));
        }
        Ok(())
    }

    /// Where the last term before `end` begins, roughly: for messages.
    fn term_before(&self, end: usize) -> usize {
        let before = self.text[..end].trim_end();
        let mut depth = 0_usize;
        let start = before.char_indices().rev().find(|(_, c)| {
            match c {
                ')' => depth += 1,
                '(' if depth > 0 => {
                    depth -= 1;
                    return false;
                }
                _ => {}
            }
            depth == 0
                && (matches!(c, '(' | ',' | '+' | '*' | '/' | '<' | '>' | '=')
                    || MINUS.iter().any(|minus| minus.starts_with(*c)))
        });
        start.map_or(0, |(at, c)| at + c.len_utf8())
    }

    /// Refuses other languages' comparisons.
    pub(super) fn no_foreign_comparison(&mut self) -> Result<(), FormulaError> {
        const FOREIGN: &[(&str, &str)] = &[
            ("===", "=="),
            ("!==", "!="),
            ("<>", "!="),
            ("=<", "<="),
            ("=>", ">="),
            ("~=", "!="),
            (":=", "=="),
            ("=", "=="),
        ];
        let here = self.here();
        let rest = self.rest();
        if rest.starts_with("==") && !rest.starts_with("===") {
            return Ok(());
        }
        let Some((foreign, ours)) = FOREIGN.iter().find(|(foreign, _)| rest.starts_with(foreign)) else {
            return Ok(());
        };
        let left = self.quoted(0, here.0);
        let help = if *foreign == "="
            && begins_name(left.chars().next().unwrap_or(' '))
            && left.chars().all(|c| is_of_name(c) || matches!(c, '(' | ')'))
            && left != "t"
        {
            format!("write what stands behind it alone, without `{left} =`; to compare, write `==`")
        } else {
            format!("write `{ours}`")
        };
        Err(error((here.0, foreign.len()), format!("`{foreign}` is no comparison")).helped(help))
    }

    /// Refuses what follows a factor with nothing between: `2t`, `90 sin(t)`, `30 deg`, `a mod b`.
    pub(super) fn no_missing_operator(&mut self, left: Span) -> Result<(), FormulaError> {
        let here = self.here();
        let rest = self.rest();
        let word = first_word(rest);
        let factor = self.quoted(left.0, left.0 + left.1);
        let at = (here.0, word.len());
        let is_called = rest[word.len()..].trim_start().starts_with('(');
        if rest.starts_with(DEGREES) {
            let number = if factor.parse::<f64>().is_ok() { factor } else { "90" };
            return Err(unit_in_formula(here, number, "°"));
        }
        if rest.starts_with(|c| SUPERSCRIPTS.contains(c)) {
            return Err(
                error(here, "a raised number belongs to what stands right before it").helped("write `^`, as in `t^2`")
            );
        }
        if word.starts_with('_') && word[1..].starts_with(|c: char| c.is_ascii_digit()) {
            return Err(error(at, "a formula's numbers have no `_`").helped(format!(
                "write `{}{}`",
                factor,
                word.replace('_', "")
            )));
        }
        if word.is_empty() && !rest.starts_with('(') {
            return Ok(());
        }
        match word {
            "and" | "or" => return Ok(()),
            "AND" | "And" | "OR" | "Or" => {
                return Err(error(at, format!("`{word}` is written in small letters"))
                    .helped(format!("write `{}`", word.to_lowercase())));
            }
            "mod" | "rem" | "MOD" | "Mod" if !is_called => {
                return Err(error(at, format!("`{word}` is a function, not an operator"))
                    .helped(format!("write `mod({factor}, …)`")));
            }
            "div" | "DIV" if !is_called => {
                return Err(error(at, format!("`{word}` is no operator")).helped(format!("write `floor({factor}/…)`")));
            }
            "if" | "else" | "then" | "where" | "when" | "for" if !is_called => {
                return Err(error(at, format!("`{word}` does not stand here"))
                    .helped("write `if(condition, a, b)`: a while the condition holds, else b"));
            }
            "xor" => return Err(error(at, "`xor` is no operator").helped("write `(a and not b) or (b and not a)`")),
            _ => {}
        }
        let is_known = word == "t"
            || words::constant(word).is_some()
            || words::function(word).is_some()
            || self.place.parameters.iter().any(|known| known.name == word);
        if !is_known && !is_called && words::is_unit(word) && factor.parse::<f64>().is_ok() {
            return Err(unit_in_formula(at, factor, word));
        }
        if !is_known && matches!(word, "x" | "X") {
            return Err(
                error(at, "`x` is unknown here").helped(format!("for times write `*`: `{factor}*…`; the time is `t`"))
            );
        }
        let bracket = if is_called || word.is_empty() { "(…)" } else { "" };
        let parted = (!is_known).then(|| parted(word)).flatten();
        let word = words::constant(word).map_or(word, |constant| constant.0);
        let word = parted.as_deref().unwrap_or(word);
        Err(error(here, format!("a `*` is missing here: write `{factor}*{word}{bracket}`")))
    }

    /// That a name is unknown, and what it may be meant for.
    pub(super) fn unknown(&mut self, name: &str, span: Span) -> FormulaError {
        if let Some(of_module) = self.of_module(name, span) {
            return of_module;
        }
        if words::function(name).is_some() {
            return self.without_brackets(name, span);
        }
        self.blank();
        let is_called = self.rest().starts_with('(');
        if let Some(parted) = parted(name) {
            let bracket = if is_called { "(…)" } else { "" };
            return error(span, format!("a `*` is missing here: write `{parted}{bracket}`"));
        }
        // `x = 3*t`: nothing but a name stands before the equals sign.
        if let Some(right) = self.rest().strip_prefix('=')
            && !right.starts_with('=')
            && self.text[..span.0].trim().is_empty()
        {
            return error(span, format!("a formula has no `{name} =`")).helped(format!(
                "write what stands behind it alone: `{}`",
                self.quoted(self.text.len() - right.len(), self.text.len())
            ));
        }
        let parameters = || self.place.parameters.iter().map(|parameter| parameter.name.as_str());
        let unknown = format!("`{name}` is unknown");
        if let Some(write) = words::elsewhere(name) {
            return error(span, unknown).helped(write);
        }
        let functions = FUNCTIONS.iter().map(|row| row.name);
        let near = if is_called {
            words::near(name, functions)
        } else {
            words::near(
                name,
                ["t"].into_iter().chain(CONSTANTS.iter().map(|row| row.0)).chain(parameters()).chain(functions),
            )
        };
        let listed = |names: &[&str]| names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
        let here: Vec<&str> = parameters().collect();
        let parameters_here =
            if here.is_empty() { String::new() } else { format!("parameters here: {}", listed(&here)) };
        let unit = words::is_unit(name).then(|| unit_in_formula(span, "90", name));
        match (near.as_slice(), is_called) {
            (_, false) if unit.is_some() && !near.iter().any(|near| near.eq_ignore_ascii_case(name)) => {
                unit.unwrap_or_else(|| error(span, unknown))
            }
            ([first, others @ ..], true) => {
                let is_exact = first.eq_ignore_ascii_case(name);
                let others = &others[..if is_exact { 0 } else { others.len().min(3) }];
                let also = if others.is_empty() { String::new() } else { format!("or {}; ", listed(others)) };
                error(span, format!("{unknown}; did you mean `{first}`?")).helped(format!("{also}{LIST}"))
            }
            ([first, ..], false) => error(span, format!("{unknown}; did you mean `{first}`?")).helped(parameters_here),
            ([], true) if here.contains(&name) => error(span, format!("`{name}` is a parameter, and no function"))
                .helped(format!("for times write `{name}*(…)`")),
            ([], true) => error(span, format!("{unknown}: it is none of the functions")).helped(LIST),
            ([], false) => {
                let help = if here.is_empty() {
                    format!("give it a value: where = {{ {name} = 2 }}")
                } else {
                    parameters_here
                };
                let help = if name.is_ascii() || !here.is_empty() {
                    help
                } else {
                    format!("give it a value: where = {{ \"{name}\" = 2 }}")
                };
                error(span, format!("{unknown}: the time is `t`, other names must be parameters")).helped(help)
            }
        }
    }

    /// A name behind a module's: np.sin, Math.PI.
    fn of_module(&mut self, name: &str, span: Span) -> Option<FormulaError> {
        let after = self.text[span.0 + span.1..].strip_prefix('.')?;
        let last = first_word(after);
        if last.is_empty() {
            return None;
        }
        let rest = &after[last.len()..];
        // Names of several modules: scipy.signal.sawtooth.
        let (word, rest) = match rest.strip_prefix('.').map(|rest| (first_word(rest), rest)) {
            Some((deeper, rest)) if !deeper.is_empty() => (deeper, &rest[deeper.len()..]),
            _ => (last, rest),
        };
        let whole = (span.0, self.text.len() - rest.len() - span.0);
        let lower = word.to_lowercase();
        let is_ours = words::function(&lower).is_some() || words::constant(&lower).is_some();
        let help = if is_ours {
            format!("write `{lower}` alone")
        } else if let Some(write) = words::elsewhere(word) {
            write.to_owned()
        } else {
            LIST.to_owned()
        };
        Some(error(whole, format!("formulas have no modules, such as `{name}`")).helped(help))
    }

    /// A function without its brackets: sin x, sin²(x), sin^2(x), exp^x.
    fn without_brackets(&mut self, name: &str, span: Span) -> FormulaError {
        self.blank();
        let is_function = format!("`{name}` is a function: its arguments go in brackets");
        let raised = |parser: &mut Self| -> Option<String> {
            let rest = parser.rest();
            let is_sign = |c: char| c == '⁻' || SUPERSCRIPTS.contains(c);
            if rest.starts_with(is_sign) {
                let length = rest.find(|c| !is_sign(c)).unwrap_or(rest.len());
                parser.at += length;
                let digit = |c: char| {
                    SUPERSCRIPTS.chars().position(|known| known == c).map_or("-".to_owned(), |n| n.to_string())
                };
                return Some(rest[..length].chars().map(digit).collect());
            }
            let behind = rest.strip_prefix("**").or_else(|| rest.strip_prefix('^'))?;
            let sign = usize::from(behind.starts_with('-'));
            let digits = behind[sign..].find(|c: char| !c.is_ascii_digit()).unwrap_or(behind.len() - sign);
            parser.at = parser.text.len() - behind.len() + sign + digits;
            Some(behind[..sign + digits].to_owned())
        };
        let before = self.at;
        if let Some(power) = raised(self) {
            let argument = self.brackets_ahead();
            let whole = (span.0, self.at - span.0);
            if name == "exp" {
                self.at = before;
                let exponent = self.rest().trim_start_matches(['^', '*']).trim();
                let exponent = self.quoted(self.text.len() - exponent.len(), self.text.len());
                let exponent =
                    exponent.split([' ', '+', ',']).next().unwrap_or_default().trim_matches(|c| matches!(c, '(' | ')'));
                return error(whole, is_function).helped(format!("write `exp({exponent})`, or `e^({exponent})`"));
            }
            let inverse = format!("a{name}");
            let call = argument.map_or("(…)", |argument| argument);
            let help = if power == "-1" && words::function(&inverse).is_some() {
                format!("write `{inverse}{call}` for the inverse, `1/{name}{call}` for one over it")
            } else if power.is_empty() {
                format!("write `{name}(…)^n`")
            } else {
                format!("write `{name}{call}^{power}`")
            };
            return error(whole, format!("a power of `{name}` stands behind its brackets")).helped(help);
        }
        let argument = self.product_ahead();
        let is_argument = argument.starts_with(|c: char| is_of_name(c) || matches!(c, '.' | '['));
        let help = if self.rest().starts_with(['[', '{']) {
            format!("write `{name}(…)` with round brackets")
        } else if is_argument {
            let end = self.text.len() - self.rest().len() + argument.len();
            format!("write `{name}({})`", self.quoted(self.at, end))
        } else {
            let example = words::function(name).map_or("", |row| row.example.0);
            format!("write, for example: `{example}`")
        };
        error(span, is_function).helped(help)
    }
}
