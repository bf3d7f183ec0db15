//! Configuration of object stores: options, environment, and the location of buckets. Plain values.
//!
//! Without keys, the crate `object_store` asks the metadata service of the cloud (169.254.169.254), which does not answer
//! outside of that cloud. So the service is asked only if the configuration names it. Otherwise requests are not signed, as
//! public buckets expect.

use std::path::PathBuf;
use std::sync::Arc;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey as S3Key};
use object_store::azure::{AzureConfigKey as AzureKey, MicrosoftAzureBuilder};
use object_store::client::HttpConnector;
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey as GoogleKey};
use object_store::{Error, ObjectStore, RetryConfig};

use crate::fetch::StoreOption;
use crate::fetch::cache::StoreAsker;

/// Creates a builder from the environment, overridden by the options.
macro_rules! configured {
    ($builder:ty, $prefix:literal, $options:expr) => {{
        let mut builder = <$builder>::from_env();
        for option in $options.iter().filter(|o| o.name().starts_with($prefix)) {
            builder = builder.with_config(option.name().parse()?, option.value());
        }
        Ok(builder)
    }};
}

/// The options that name credentials, or the service that hands them out. Without any of them requests are not signed.
const S3_KEYS: [S3Key; 6] = [
    S3Key::AccessKeyId,
    S3Key::SecretAccessKey,
    S3Key::WebIdentityTokenFile,
    S3Key::ContainerCredentialsRelativeUri,
    S3Key::ContainerCredentialsFullUri,
    S3Key::MetadataEndpoint,
];
const GOOGLE_KEYS: [GoogleKey; 4] = [
    GoogleKey::ServiceAccount,
    GoogleKey::ServiceAccountKey,
    GoogleKey::ApplicationCredentials,
    GoogleKey::BearerToken,
];
const AZURE_KEYS: [AzureKey; 9] = [
    AzureKey::AccessKey,
    AzureKey::SasKey,
    AzureKey::Token,
    AzureKey::ClientId,
    AzureKey::ObjectId,
    AzureKey::MsiResourceId,
    AzureKey::MsiEndpoint,
    AzureKey::FabricTokenServiceUrl,
    AzureKey::CredentialType,
];

/// Returns the store of a bucket, such as `s3://tiles`, whose requests a connector sends.
pub(super) fn store(
    bucket: &str,
    options: &[StoreOption],
    retry: RetryConfig,
    connector: impl HttpConnector,
) -> Result<Arc<dyn ObjectStore>, Error> {
    macro_rules! built {
        ($configured:expr) => {
            Arc::new($configured?.with_url(bucket).with_retry(retry).with_http_connector(connector).build()?)
        };
    }
    Ok(match bucket.split_once(':').map(|(scheme, _)| scheme.to_ascii_lowercase()).as_deref() {
        Some("s3") => built!(s3(options)),
        Some("gs") => built!(google(options)),
        _ => built!(azure(options)),
    })
}

/// Returns the builder for S3. Requests are not signed without keys.
fn s3(options: &[StoreOption]) -> Result<AmazonS3Builder, Error> {
    let builder: Result<AmazonS3Builder, Error> = configured!(AmazonS3Builder, "aws_", options);
    let builder = builder?;
    let has_keys = S3_KEYS.iter().any(|key| builder.get_config_value(key).is_some());
    let is_open = !has_keys && !is_set(options, &["aws_skip_signature"]);
    Ok(if is_open { builder.with_skip_signature(true) } else { builder })
}

/// Returns the builder for Google Cloud Storage. Requests are not signed without keys.
fn google(options: &[StoreOption]) -> Result<GoogleCloudStorageBuilder, Error> {
    let builder: Result<GoogleCloudStorageBuilder, Error> = configured!(GoogleCloudStorageBuilder, "google_", options);
    let builder = builder?;
    let has_keys =
        GOOGLE_KEYS.iter().any(|key| builder.get_config_value(key).is_some()) || has_application_credentials();
    let services = ["google_skip_signature", "gce_metadata_host", "gce_metadata_root", "gce_metadata_ip"];
    let is_open = !has_keys && !is_set(options, &services);
    Ok(if is_open { builder.with_skip_signature(true) } else { builder })
}

/// Returns the builder for Azure. Requests are not signed without keys.
fn azure(options: &[StoreOption]) -> Result<MicrosoftAzureBuilder, Error> {
    let builder: Result<MicrosoftAzureBuilder, Error> = configured!(MicrosoftAzureBuilder, "azure_", options);
    let builder = builder?;
    let is_on = |key: AzureKey| builder.get_config_value(&key).as_deref().is_some_and(is_true);
    let has_keys = AZURE_KEYS.iter().any(|key| builder.get_config_value(key).is_some())
        || is_on(AzureKey::UseAzureCli)
        || is_on(AzureKey::UseEmulator);
    let is_open = !has_keys && !is_set(options, &["azure_skip_signature"]);
    Ok(if is_open { builder.with_skip_signature(true) } else { builder })
}

/// Returns the locations of the stores and the credentials that they get, for the keys of the cache. Objects of the same
/// bucket and key differ between stores, and may differ between users. An invalid configuration is left out; its first request
/// fails.
pub(in crate::fetch) fn askers(options: &[StoreOption]) -> Vec<StoreAsker> {
    let s3 = s3(options).ok().map(|builder| {
        let of = |key: S3Key| builder.get_config_value(&key);
        let apart = |region: &String| region.starts_with("cn-") || region.starts_with("us-gov-");
        let location =
            of(S3Key::S3Endpoint).or_else(|| of(S3Key::Endpoint)).or_else(|| of(S3Key::Region).filter(apart));
        asker("s3", location, of(S3Key::SkipSignature), S3_KEYS.map(of))
    });
    let google = google(options).ok().map(|builder| {
        let of = |key: GoogleKey| builder.get_config_value(&key);
        asker("gs", of(GoogleKey::BaseUrl), of(GoogleKey::SkipSignature), GOOGLE_KEYS.map(of))
    });
    let azure = azure(options).ok().map(|builder| {
        let of = |key: AzureKey| builder.get_config_value(&key);
        let is_on = |key: AzureKey| of(key).as_deref().is_some_and(is_true);
        let account = of(AzureKey::AccountName).unwrap_or_default();
        let fabric = if is_on(AzureKey::UseFabricEndpoint) { " fabric" } else { "" };
        let location = if is_on(AzureKey::UseEmulator) {
            let at = std::env::var("AZURITE_BLOB_STORAGE_URL").unwrap_or_default();
            Some(format!("emulator {at} {account}"))
        } else {
            of(AzureKey::Endpoint).or_else(|| (!account.is_empty()).then(|| format!("{account}{fabric}")))
        };
        let keys = AZURE_KEYS.into_iter().chain([AzureKey::ClientSecret, AzureKey::UseAzureCli]);
        asker("az", location, of(AzureKey::SkipSignature), keys.map(of))
    });
    [s3, google, azure].into_iter().flatten().collect()
}

fn asker(
    scheme: &'static str,
    location: Option<String>,
    skips_signature: Option<String>,
    keys: impl IntoIterator<Item = Option<String>>,
) -> StoreAsker {
    let mut credentials = Vec::new();
    if !skips_signature.as_deref().is_some_and(is_true) {
        // Keys that are not in the configuration are those of this machine or of its user.
        credentials.push(b's');
        for (value, index) in keys.into_iter().zip(0u8..) {
            let Some(value) = value else { continue };
            credentials.push(index);
            credentials.extend_from_slice(&(value.len() as u64).to_le_bytes());
            credentials.extend_from_slice(value.as_bytes());
        }
    }
    let location = location.map(|at| at.trim_end_matches('/').to_owned());
    StoreAsker { scheme, location, credentials }
}

fn is_true(text: &str) -> bool {
    ["true", "1", "yes", "on", "y"].iter().any(|yes| text.eq_ignore_ascii_case(yes))
}

/// Returns true if one of the names is set as an option or as an environment variable.
fn is_set(options: &[StoreOption], names: &[&str]) -> bool {
    names
        .iter()
        .any(|name| options.iter().any(|o| o.name() == *name) || std::env::var_os(name.to_ascii_uppercase()).is_some())
}

/// Returns true if the user has Google's application default credentials.
fn has_application_credentials() -> bool {
    let (home, file) = if cfg!(windows) {
        ("APPDATA", "gcloud/application_default_credentials.json")
    } else {
        ("HOME", ".config/gcloud/application_default_credentials.json")
    };
    std::env::var_os(home).is_some_and(|home| PathBuf::from(home).join(file).exists())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asker_of(scheme: &str, options: &[(&str, &str)]) -> Option<StoreAsker> {
        let options: Vec<_> = options.iter().map(|(name, value)| StoreOption::new(name, value)).collect();
        askers(&options).into_iter().find(|asker| asker.scheme == scheme)
    }

    #[test]
    fn stores_differ_by_location() {
        let of = |scheme: &str, options: &[(&str, &str)]| asker_of(scheme, options).and_then(|asker| asker.location);
        let s3 = |at| of("s3", &[("aws_endpoint_url", at)]);
        assert_eq!(s3("https://a.example/"), s3("https://a.example"));
        assert_ne!(s3("https://a.example"), s3("https://b.example"));
        let both = [("aws_endpoint", "https://a.example"), ("aws_endpoint_url_s3", "https://b.example")];
        assert_eq!(of("s3", &both), s3("https://b.example"));
        let region = |region| of("s3", &[("aws_region", region), ("aws_endpoint", "https://a.example")]);
        assert_eq!(region("eu-west-1"), region("us-east-1"), "a bucket is the same from every region");
        assert_ne!(of("gs", &[("google_base_url", "https://a.example")]), of("gs", &[]));
        let azure = |account| of("az", &[("azure_storage_account_name", account)]);
        assert_ne!(azure("one"), azure("two"));
        let fabric = [("azure_storage_account_name", "one"), ("azure_use_fabric_endpoint", "true")];
        assert_ne!(of("az", &fabric), azure("one"));
        let emulator = [("azure_storage_account_name", "one"), ("azure_storage_use_emulator", "true")];
        assert_ne!(of("az", &emulator), azure("one"));
        assert!(of("s3", &[("aws_colour", "red")]).is_none(), "invalid; the first request fails");
    }

    #[test]
    fn signed_requests_differ_by_credentials() {
        let of = |scheme: &str, options: &[(&str, &str)]| asker_of(scheme, options).unwrap().credentials;
        let s3 = |id, secret| of("s3", &[("aws_access_key_id", id), ("aws_secret_access_key", secret)]);
        assert!(s3("a", "1") == s3("a", "1") && s3("a", "1") != s3("a", "2") && s3("a", "1") != s3("b", "1"));
        assert_ne!(of("gs", &[("google_bearer_token", "1")]), of("gs", &[("google_bearer_token", "2")]));
        assert_ne!(of("az", &[("azure_storage_account_key", "1")]), of("az", &[("azure_storage_account_key", "2")]));
        for (scheme, prefix) in [("s3", "aws"), ("gs", "google"), ("az", "azure")] {
            let unsigned = of(scheme, &[(&format!("{prefix}_skip_signature"), "true")]);
            assert!(unsigned.is_empty(), "{scheme}: existing caches of public buckets stay valid");
        }
    }
}
