//! Encrypted connections, with a certificate that is generated at the start. Clients trust it by its file.

use std::net::TcpStream;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use rcgen::{CertificateParams, DnType, ExtendedKeyUsagePurpose, KeyPair};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::PrivateKeyDer;
use tokio_rustls::rustls::{self, StreamOwned};

use super::args::ServeArgs;
use super::server::{IDLE_TIMEOUT, Server};
use super::{http1, http2};

const HTTP_2: &[u8] = b"h2";
const HTTP_1: &[u8] = b"http/1.1";

/// The acceptor of encrypted connections.
pub(super) struct Tls(TlsAcceptor);

impl Tls {
    /// Generates a certificate for the listening address and this machine, and writes it to a file.
    pub(super) fn new(file: &Path, args: &ServeArgs) -> Result<Self> {
        let key = KeyPair::generate()?;
        let mut names = ["localhost", "127.0.0.1", "::1"].map(str::to_owned).to_vec();
        if !names.contains(&args.bind) {
            names.push(args.bind.clone());
        }
        let mut params = CertificateParams::new(names).with_context(|| format!("a certificate for {}", args.bind))?;
        params.distinguished_name.push(DnType::CommonName, "terrane serve");
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        let certificate = params.self_signed(&key)?;
        std::fs::write(file, certificate.pem()).with_context(|| file.display().to_string())?;
        let key = PrivateKeyDer::from(key);
        let mut config = rustls::ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()?
            .with_no_client_auth()
            .with_single_cert(vec![certificate.der().clone()], key)?;
        let offers: &[&[u8]] = match (args.http1, args.http2) {
            (true, _) => &[HTTP_1],
            (_, true) => &[HTTP_2],
            _ => &[HTTP_2, HTTP_1],
        };
        config.alpn_protocols = offers.iter().map(|name| name.to_vec()).collect();
        Ok(Self(TlsAcceptor::from(Arc::new(config))))
    }

    /// Serves a connection with the version of HTTP that was negotiated.
    pub(super) fn serve(&self, server: &Arc<Server>, stream: TcpStream) -> std::io::Result<()> {
        let socket = stream.try_clone()?;
        stream.set_nonblocking(true)?;
        let runtime = http2::runtime()?;
        let stream = runtime.block_on(async {
            let stream = tokio::net::TcpStream::from_std(stream)?;
            tokio::time::timeout(IDLE_TIMEOUT, self.0.accept(stream)).await?
        })?;
        if stream.get_ref().1.alpn_protocol() == Some(HTTP_2) {
            return runtime.block_on(http2::serve(server, &socket, stream));
        }
        let (stream, connection) = stream.into_inner();
        let stream = stream.into_std()?;
        stream.set_nonblocking(false)?;
        drop((runtime, socket));
        http1::serve(server, StreamOwned::new(connection, stream))
    }
}
