//! The tokens that open the server: where they are read, and which connection may use which.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use subtle::{Choice, ConstantTimeEq};

/// Fewest characters of a token: what is shorter can be guessed.
const SHORTEST: usize = 16;

/// A secret that opens the server, and whose it is. The secret is never shown.
#[derive(Clone)]
pub(crate) struct Token {
    /// Whose it is.
    pub(crate) name: Arc<str>,
    secret: String,
}

impl std::fmt::Debug for Token {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Token({})", self.name)
    }
}

impl Token {
    /// Reads tokens, one a line, each with its name before it if it has one; what follows a # is a
    /// remark.
    pub(crate) fn read(source: &str, text: &str) -> Result<Vec<Self>, String> {
        let fail = |reason: String| Err(format!("{source}: {reason}"));
        let mut tokens: Vec<Self> = Vec::new();
        for line in text.lines().map(str::trim) {
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let words: Vec<&str> = line.split_whitespace().collect();
            let (name, secret) = match words[..] {
                [secret] => (format!("token {}", tokens.len() + 1), secret),
                [name, secret] => (name.to_owned(), secret),
                _ => ("?".to_owned(), ""),
            };
            if secret.len() < SHORTEST || !secret.bytes().all(|byte| byte.is_ascii_graphic()) {
                return fail(format!(
                    "a token is at least {SHORTEST} printable ASCII characters without spaces, one \
                     a line, with its name and a space before it if it has one"
                ));
            }
            if tokens.iter().any(|token| *token.name == *name) {
                return fail(format!("there are two tokens named {name:?}"));
            }
            tokens.push(Self { name: name.into(), secret: secret.to_owned() });
        }
        if tokens.is_empty() {
            return fail(format!(
                "there is no token, at least {SHORTEST} printable ASCII characters"
            ));
        }
        Ok(tokens)
    }
}

/// Reads the tokens of a file, and warns where others of the machine can.
pub(crate) fn read_file(path: &Path) -> Result<Vec<Token>, String> {
    let text = std::fs::read_to_string(path)
        .map_err(|error| format!("token_file {}: {error}", path.display()))?;
    Token::read("token_file", &text)
}

/// Warns of a file with a secret that every user of the machine can read.
pub(crate) fn warn_if_open(what: &str, path: &Path) {
    use std::os::unix::fs::PermissionsExt as _;

    let mode = std::fs::metadata(path).map(|file| file.permissions().mode());
    if let Ok(mode) = mode
        && mode & 0o004 != 0
    {
        let mode = mode & 0o777;
        tracing::warn!(
            "{what} {}: every user of this machine can read it (mode {mode:03o}); chmod 600",
            path.display()
        );
    }
}

/// The tokens at a time.
#[derive(Debug, Default)]
struct Current {
    tokens: Vec<Token>,
    /// Those that are none any more, for the connections before this number.
    retired: Vec<(Token, u64)>,
}

/// The tokens that open the server; without any it is open.
#[derive(Debug)]
pub(crate) struct Tokens {
    file: Option<PathBuf>,
    current: RwLock<Current>,
}

impl Tokens {
    /// These tokens, which are in a file if they can be exchanged.
    pub(crate) fn new(tokens: Vec<Token>, file: Option<PathBuf>) -> Self {
        if let Some(file) = &file {
            warn_if_open("token_file", file);
        }
        Self { file, current: RwLock::new(Current { tokens, retired: Vec::new() }) }
    }

    /// Whether every call passes.
    pub(crate) fn is_empty(&self) -> bool {
        self.current.read().unwrap_or_else(PoisonError::into_inner).tokens.is_empty()
    }

    /// Whose secret was given over a connection, compared in a time that tells nothing of where it
    /// differs.
    pub(crate) fn owner(&self, given: &[u8], connection: u64) -> Option<Arc<str>> {
        let current = self.current.read().unwrap_or_else(PoisonError::into_inner);
        let retired = current.retired.iter().filter(|(_, first)| connection < *first);
        let all = current.tokens.iter().chain(retired.map(|(token, _)| token));
        let mut owner = None;
        for token in all {
            let same: Choice = given.ct_eq(token.secret.as_bytes());
            if bool::from(same) {
                owner = Some(Arc::clone(&token.name));
            }
        }
        owner
    }

    /// Reads the file again. What it does not hold any more opens nothing over the connections from
    /// number `first` on; what is older stays as it was let in.
    pub(crate) fn reload(&self, first: u64) -> Result<(), String> {
        let Some(file) = &self.file else { return Ok(()) };
        let tokens = read_file(file)?;
        warn_if_open("token_file", file);
        let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
        let gone = std::mem::replace(&mut current.tokens, tokens);
        let Current { tokens, retired } = &mut *current;
        let known = |token: &Token| tokens.iter().any(|other| other.secret == token.secret);
        let gone: Vec<Token> = gone.into_iter().filter(|token| !known(token)).collect();
        retired.extend(gone.into_iter().map(|token| (token, first)));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: &str = "0123456789abcdef";
    const TWO: &str = "fedcba9876543210";

    #[test]
    fn files_hold_tokens_with_and_without_names() {
        let names = |text: &str| {
            let tokens = Token::read("it", text);
            tokens.map(|all| all.iter().map(|token| token.name.to_string()).collect::<Vec<_>>())
        };
        assert_eq!(names(&format!(" {ONE}\n")).expect("one"), ["token 1"]);
        let both = format!("# who may\n\nlab {ONE}\nnotebook\t{TWO}\n");
        assert_eq!(names(&both).expect("two"), ["lab", "notebook"]);
        for (text, expected) in [
            ("", "it: there is no token"),
            ("# nobody", "it: there is no token"),
            ("lab sesame", "it: a token is at least 16"),
            ("open sesame, I say to you", "it: a token is at least 16"),
            ("0123456789abcdeé", "it: a token is at least 16"),
        ] {
            let message = names(text).expect_err(expected).to_string();
            assert!(message.starts_with(expected), "{message}");
            assert!(!message.contains("sesame"), "{message}");
        }
        let twice = names(&format!("lab {ONE}\nlab {TWO}")).expect_err("twice").to_string();
        assert_eq!(twice, "it: there are two tokens named \"lab\"");
    }

    #[test]
    fn what_goes_stays_for_the_connections_that_there_were() {
        let name = format!("octoarm-tokens-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let write = |text: &str| std::fs::write(&path, text).expect("written");
        write(&format!("lab {ONE}"));
        let tokens = Tokens::new(read_file(&path).expect("read"), Some(path.clone()));
        let owner = |secret: &str, connection| {
            tokens.owner(secret.as_bytes(), connection).map(|name| name.to_string())
        };
        assert_eq!(owner(ONE, 1).as_deref(), Some("lab"));
        assert_eq!(owner(TWO, 1), None);
        write(&format!("other {TWO}"));
        tokens.reload(5).expect("reloaded");
        assert_eq!(owner(ONE, 4).as_deref(), Some("lab"));
        assert_eq!(owner(ONE, 5), None);
        assert_eq!(owner(TWO, 4).as_deref(), Some("other"));
        // What cannot be used changes nothing.
        write("short");
        assert!(tokens.reload(9).is_err());
        assert_eq!(owner(TWO, 20).as_deref(), Some("other"));
        std::fs::remove_file(&path).expect("removed");
        assert!(!format!("{tokens:?}").contains(TWO));
    }
}
