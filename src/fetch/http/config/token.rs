//! [`ExpiringToken`]: an access token that a service issues for a while and renews on request.

use std::fmt;
use std::sync::{Mutex, PoisonError};

use reqwest::header::HeaderValue;
use serde_json::Value;

use crate::fetch::{IoError, Limits};

/// A token for the header `Authorization`. Shared by all requests that carry it.
pub(in crate::fetch) struct ExpiringToken {
    /// The address that issues it. Its query has the user's own key.
    endpoint: String,
    /// The number of renewals so far, and the header. Locked briefly.
    current: Mutex<(u32, HeaderValue)>,
    /// Held while a new token is requested, so that many refused requests ask for one token.
    renewal: tokio::sync::Mutex<()>,
}

impl ExpiringToken {
    /// Creates a token that `endpoint` issued in `accessToken` of its answer.
    pub fn new(endpoint: String, token: &str) -> Result<Self, IoError> {
        let current = Mutex::new((0, bearer(&endpoint, token)?));
        Ok(Self { endpoint, current, renewal: tokio::sync::Mutex::default() })
    }

    /// Returns the address that issues the token.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Returns the number of renewals so far.
    pub fn number(&self) -> u32 {
        self.current.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    /// Returns the header.
    pub fn header(&self) -> HeaderValue {
        self.current.lock().unwrap_or_else(PoisonError::into_inner).1.clone()
    }

    /// Replaces the token of a number, which a server has refused. Does nothing if another request has replaced it.
    /// `request` gets the answer of the endpoint.
    ///
    /// # Errors
    /// Fails if the endpoint does, or answers without a token.
    pub async fn renew(
        &self,
        refused: u32,
        request: impl AsyncFnOnce(&str) -> Result<Vec<u8>, IoError>,
    ) -> Result<(), IoError> {
        let _alone = self.renewal.lock().await;
        if self.number() != refused {
            return Ok(());
        }
        let answer = request(&self.endpoint).await?;
        let header = bearer(&self.endpoint, &token_of(&self.endpoint, &answer)?)?;
        *self.current.lock().unwrap_or_else(PoisonError::into_inner) = (refused.wrapping_add(1), header);
        Ok(())
    }
}

/// Returns the token in the answer of an endpoint.
fn token_of(endpoint: &str, answer: &[u8]) -> Result<String, IoError> {
    Limits::default().check_json(endpoint, answer)?;
    let answer: Value = serde_json::from_slice(answer).map_err(|e| IoError::invalid(endpoint, e.to_string()))?;
    let token = answer.get("accessToken").and_then(Value::as_str);
    token.map(str::to_owned).ok_or_else(|| IoError::invalid(endpoint, "the answer has no accessToken"))
}

fn bearer(endpoint: &str, token: &str) -> Result<HeaderValue, IoError> {
    let mut value = HeaderValue::from_str(&format!("Bearer {token}"))
        .map_err(|_| IoError::invalid(endpoint, "accessToken is not valid in a header"))?;
    value.set_sensitive(true);
    Ok(value)
}

impl PartialEq for ExpiringToken {
    fn eq(&self, other: &Self) -> bool {
        self.endpoint == other.endpoint
    }
}

impl fmt::Debug for ExpiringToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ExpiringToken").finish_non_exhaustive()
    }
}
