// Measures the C++ reference decoders on one file; tools/peers/decoders/run builds it, benches/decoders.rs calls it.
//
//   decoders draco FILE
//   decoders meshopt-vertices FILE COUNT STRIDE
//   decoders meshopt-indices FILE COUNT
//   decoders ktx2 FILE bc1|bc3|bc7        all levels; only if built with -DWITH_BASISU
//
// Prints the shortest time of a decode in microseconds, measured over 0.2 s, and a sum of the decoded bytes.
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <iterator>
#include <memory>
#include <string>
#include <vector>

#include <draco/compression/decode.h>
#include <meshoptimizer.h>
#ifdef WITH_BASISU
#include "basisu_transcoder.h"
#endif

using Bytes = std::vector<uint8_t>;

static void fail(const std::string &why) {
    std::fprintf(stderr, "decoders: %s\n", why.c_str());
    std::exit(1);
}

static uint64_t sum(const void *data, size_t bytes) {
    auto at = static_cast<const uint8_t *>(data);
    uint64_t total = 0;
    for (size_t i = 0; i < bytes; ++i) total += at[i];
    return total;
}

// Runs a decode, which returns the sum of its bytes outside of the measured time, for 0.2 s.
static void measure(const std::function<void()> &decode, const std::function<uint64_t()> &result) {
    using Clock = std::chrono::steady_clock;
    double shortest = 1e300;
    auto end = Clock::now() + std::chrono::milliseconds(200);
    do {
        auto start = Clock::now();
        decode();
        shortest = std::min(shortest, std::chrono::duration<double, std::micro>(Clock::now() - start).count());
    } while (Clock::now() < end);
    std::printf("%.1f %llu\n", shortest, static_cast<unsigned long long>(result()));
}

static void draco_mesh(const Bytes &file) {
    std::unique_ptr<draco::Mesh> mesh;
    auto decode = [&] {
        draco::DecoderBuffer buffer;
        buffer.Init(reinterpret_cast<const char *>(file.data()), file.size());
        auto decoded = draco::Decoder().DecodeMeshFromBuffer(&buffer);
        if (!decoded.ok()) fail(decoded.status().error_msg_string());
        mesh = std::move(decoded).value();
    };
    measure(decode, [&] { return uint64_t(mesh->num_faces()); });
}

#ifdef WITH_BASISU
static void ktx2(const Bytes &file, const std::string &format) {
    using namespace basist;
    basisu_transcoder_init();
    auto target = format == "bc1" ? transcoder_texture_format::cTFBC1_RGB
        : format == "bc3" ? transcoder_texture_format::cTFBC3_RGBA : transcoder_texture_format::cTFBC7_RGBA;
    uint32_t block_bytes = format == "bc1" ? 8 : 16;
    std::vector<Bytes> levels;
    auto decode = [&] {
        ktx2_transcoder transcoder;
        if (!transcoder.init(file.data(), uint32_t(file.size())) || !transcoder.start_transcoding()) fail("no KTX2 file");
        levels.resize(transcoder.get_levels());
        for (uint32_t level = 0; level < transcoder.get_levels(); ++level) {
            ktx2_image_level_info info;
            transcoder.get_image_level_info(info, level, 0, 0);
            levels[level].resize(size_t(info.m_total_blocks) * block_bytes);
            uint32_t flags = cDecodeFlagsHighQuality | cDecodeFlagsBC1ForbidThreeColorBlocks;
            if (!transcoder.transcode_image_level(level, 0, 0, levels[level].data(), info.m_total_blocks, target, flags))
                fail("a level cannot be transcoded");
        }
    };
    measure(decode, [&] {
        uint64_t total = 0;
        for (auto &level : levels) total += level.size();
        return total;
    });
}
#endif

int main(int count, char **arguments) {
    std::vector<std::string> words(arguments + 1, arguments + count);
    if (words.size() < 2) fail("usage: decoders KIND FILE ...");
    std::ifstream stream(words[1], std::ios::binary);
    Bytes file((std::istreambuf_iterator<char>(stream)), std::istreambuf_iterator<char>());
    auto number = [&](size_t at) { return words.size() > at ? size_t(std::strtoull(words[at].c_str(), nullptr, 10)) : 0; };
    if (words[0] == "draco") {
        draco_mesh(file);
    } else if (words[0] == "meshopt-vertices") {
        Bytes out(number(2) * number(3));
        auto decode = [&] {
            if (meshopt_decodeVertexBuffer(out.data(), number(2), number(3), file.data(), file.size()) != 0) fail("vertices");
        };
        measure(decode, [&] { return sum(out.data(), out.size()); });
    } else if (words[0] == "meshopt-indices") {
        std::vector<uint32_t> out(number(2));
        auto decode = [&] {
            if (meshopt_decodeIndexBuffer(out.data(), out.size(), file.data(), file.size()) != 0) fail("indices");
        };
        measure(decode, [&] { return sum(out.data(), 4 * out.size()); });
#ifdef WITH_BASISU
    } else if (words[0] == "ktx2" && words.size() == 3) {
        ktx2(file, words[2]);
#endif
    } else {
        fail("unknown kind " + words[0]);
    }
}
