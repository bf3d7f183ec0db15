//! Configuration of object stores: options, environment, and the location of buckets.
//!
//! Without keys, the crate `object_store` asks the metadata service of the cloud (169.254.169.254), which does not answer
//! outside of that cloud. So the service is asked only if the configuration names it. Otherwise requests are not signed, as
//! public buckets expect.

use std::path::PathBuf;

use object_store::Error;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey as S3Key};
use object_store::azure::{AzureConfigKey as AzureKey, MicrosoftAzureBuilder};
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey as GoogleKey};

use crate::fetch::StoreOption;

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

/// Returns the builder for S3. Requests are not signed without keys.
pub(super) fn s3(options: &[StoreOption]) -> Result<AmazonS3Builder, Error> {
    let builder: Result<AmazonS3Builder, Error> = configured!(AmazonS3Builder, "aws_", options);
    let builder = builder?;
    let keys = [
        S3Key::AccessKeyId,
        S3Key::SecretAccessKey,
        S3Key::WebIdentityTokenFile,
        S3Key::ContainerCredentialsRelativeUri,
        S3Key::ContainerCredentialsFullUri,
        S3Key::MetadataEndpoint,
    ];
    let has_keys = keys.iter().any(|key| builder.get_config_value(key).is_some());
    let is_open = !has_keys && !is_set(options, &["aws_skip_signature"]);
    Ok(if is_open { builder.with_skip_signature(true) } else { builder })
}

/// Returns the builder for Google Cloud Storage. Requests are not signed without keys.
pub(super) fn google(options: &[StoreOption]) -> Result<GoogleCloudStorageBuilder, Error> {
    let builder: Result<GoogleCloudStorageBuilder, Error> = configured!(GoogleCloudStorageBuilder, "google_", options);
    let builder = builder?;
    let keys = [
        GoogleKey::ServiceAccount,
        GoogleKey::ServiceAccountKey,
        GoogleKey::ApplicationCredentials,
        GoogleKey::BearerToken,
    ];
    let has_keys = keys.iter().any(|key| builder.get_config_value(key).is_some()) || has_application_credentials();
    let services = ["google_skip_signature", "gce_metadata_host", "gce_metadata_root", "gce_metadata_ip"];
    let is_open = !has_keys && !is_set(options, &services);
    Ok(if is_open { builder.with_skip_signature(true) } else { builder })
}

/// Returns the builder for Azure. Requests are not signed without keys.
pub(super) fn azure(options: &[StoreOption]) -> Result<MicrosoftAzureBuilder, Error> {
    let builder: Result<MicrosoftAzureBuilder, Error> = configured!(MicrosoftAzureBuilder, "azure_", options);
    let builder = builder?;
    let keys = [
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
    let is_on = |key: AzureKey| builder.get_config_value(&key).as_deref().is_some_and(is_true);
    let has_keys = keys.iter().any(|key| builder.get_config_value(key).is_some())
        || is_on(AzureKey::UseAzureCli)
        || is_on(AzureKey::UseEmulator);
    let is_open = !has_keys && !is_set(options, &["azure_skip_signature"]);
    Ok(if is_open { builder.with_skip_signature(true) } else { builder })
}

/// Returns the location of the buckets of each scheme, unless it is the scheme's default. The cache uses it to distinguish
/// objects of the same bucket and key in different stores. An invalid configuration has no location; its first request fails.
pub(in crate::fetch) fn locations(options: &[StoreOption]) -> Vec<(&'static str, String)> {
    let s3 = s3(options).ok().and_then(|builder| {
        let of = |key: S3Key| builder.get_config_value(&key);
        let apart = |region: &String| region.starts_with("cn-") || region.starts_with("us-gov-");
        of(S3Key::S3Endpoint).or_else(|| of(S3Key::Endpoint)).or_else(|| of(S3Key::Region).filter(apart))
    });
    let google = google(options).ok().and_then(|builder| builder.get_config_value(&GoogleKey::BaseUrl));
    let azure = azure(options).ok().and_then(|builder| {
        let of = |key: AzureKey| builder.get_config_value(&key);
        let is_on = |key: AzureKey| of(key).as_deref().is_some_and(is_true);
        let account = of(AzureKey::AccountName).unwrap_or_default();
        if is_on(AzureKey::UseEmulator) {
            let at = std::env::var("AZURITE_BLOB_STORAGE_URL").unwrap_or_default();
            return Some(format!("emulator {at} {account}"));
        }
        let fabric = if is_on(AzureKey::UseFabricEndpoint) { " fabric" } else { "" };
        of(AzureKey::Endpoint).or_else(|| (!account.is_empty()).then(|| format!("{account}{fabric}")))
    });
    let named = [("s3", s3), ("gs", google), ("az", azure)];
    named.into_iter().filter_map(|(scheme, at)| Some((scheme, at?.trim_end_matches('/').to_owned()))).collect()
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

    fn locations_of(options: &[(&str, &str)]) -> Vec<(&'static str, String)> {
        let options: Vec<_> = options.iter().map(|(name, value)| StoreOption::new(name, value)).collect();
        locations(&options)
    }

    #[test]
    fn stores_differ_by_location() {
        let of = |scheme: &str, options: &[(&str, &str)]| {
            locations_of(options).into_iter().find(|(s, _)| *s == scheme).map(|(_, at)| at)
        };
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
}
