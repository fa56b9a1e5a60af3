// SPDX-License-Identifier: Apache-2.0
#include "tempera/frames/cryptomatte.h"

#include <bit>

#include "test_files.h"

namespace tempera {
namespace {

class Cryptomatte : public test::TestFolder {};

TEST(MurmurHash, KnownValues) {  // the published test vectors of MurmurHash3_x86_32
  EXPECT_EQ(murmur_hash3_32("", 0), 0u);
  EXPECT_EQ(murmur_hash3_32("", 1), 0x514E28B7u);
  EXPECT_EQ(murmur_hash3_32("", 0xffffffffu), 0x81F16F39u);
  EXPECT_EQ(murmur_hash3_32(std::string_view("\0\0\0\0", 4), 0), 0x2362F9DEu);
  EXPECT_EQ(murmur_hash3_32(std::string_view("\xff\xff\xff\xff", 4), 0), 0x76293B50u);
  EXPECT_EQ(murmur_hash3_32(std::string_view("\x21\x43\x65\x87", 4), 0x5082EDEEu), 0x2362F9DEu);
  EXPECT_EQ(murmur_hash3_32(std::string_view("\x21\x43\x65", 3), 0), 0x7E4A8634u);
  EXPECT_EQ(murmur_hash3_32(std::string_view("\x21\x43", 2), 0), 0xA0F7B07Au);
  EXPECT_EQ(murmur_hash3_32(std::string_view("\x21", 1), 0), 0x72661CF4u);
  EXPECT_EQ(murmur_hash3_32("Hello, world!", 0x9747b28cu), 0x24884CBAu);
}

TEST(CryptomatteId, ValuesOfTheReferenceImplementation) {  // unit tests of Psyop/Cryptomatte (nuke)
  EXPECT_EQ(cryptomatte_id("hello"), 6.0705627102400005616e-17f);
  EXPECT_EQ(cryptomatte_id("cube"), -4.08461912519e+15f);
  EXPECT_EQ(cryptomatte_id("sphere"), 2.79018604383e+15f);
  EXPECT_EQ(cryptomatte_id("plane"), 3.66557617593e-11f);
  EXPECT_EQ(cryptomatte_id("\xd1\x80\xd0\xb0\xd0\xb2\xd0\xbd\xd0\xb8\xd0\xbd\xd0\xb0"), -1.3192631212399999468e-25f);
  EXPECT_EQ(cryptomatte_id("m\xc3\xa4"
                           "dchen"),
            6.2361298211599995797e+25f);
}

TEST(CryptomatteId, IsAlwaysANormalFloat) {
  int flipped = 0;
  for (int i = 0; i < 20000; ++i) {
    const std::string name = "object " + std::to_string(i);
    const float id = cryptomatte_id(name);
    EXPECT_EQ(std::fpclassify(id), FP_NORMAL) << name;
    const std::uint32_t difference = cryptomatte_hash(name) ^ murmur_hash3_32(name);
    EXPECT_TRUE(difference == 0 || difference == 1u << 23);
    flipped += difference != 0;
  }
  EXPECT_NEAR(flipped, 20000 * 2 / 256, 60);
}

TEST_F(Cryptomatte, RanksByCoverage) {
  const float a = cryptomatte_id("a"), b = cryptomatte_id("b"), c = cryptomatte_id("c");
  CryptomatteBuffer buffer(2, 1);
  buffer.add(0, 0, a, 1);
  buffer.add(0, 0, b, 2);
  buffer.add(0, 0, a, 0.5f);
  buffer.add(0, 0, 0, 0.25f);  // nothing hit
  buffer.add(0, 0, c, 0.25f);
  Frame f(2, 1);
  buffer.write(f, {"a", "b", "c", "unseen"});
  ASSERT_EQ(f.layer_names(), (std::vector<std::string>{"CryptoObject00", "CryptoObject01", "CryptoObject02"}));
  const float* first = f.layer("CryptoObject00").pixel(0, 0);
  EXPECT_EQ(first[0], b);
  EXPECT_EQ(first[1], 0.5f);
  EXPECT_EQ(first[2], a);
  EXPECT_EQ(first[3], 0.375f);
  EXPECT_EQ(f.layer("CryptoObject01").at(0, 0, 0), c);
  EXPECT_EQ(f.layer("CryptoObject01").at(0, 0, 1), 0.0625f);
  EXPECT_EQ(f.layer("CryptoObject01").at(0, 0, 2), 0);
  EXPECT_EQ(f.layer("CryptoObject00").at(1, 0, 1), 0) << "no sample, no coverage";
  EXPECT_EQ(cryptomatte_matte(f, a).at(0, 0), 0.375f);
  EXPECT_EQ(cryptomatte_matte(f, cryptomatte_id("unseen")).at(0, 0), 0);
}

TEST_F(Cryptomatte, DepthLimitsTheRanksAndNegativeWeightsAreDropped) {
  CryptomatteBuffer buffer(1, 1);
  for (int i = 0; i < 9; ++i) buffer.add(0, 0, cryptomatte_id(std::to_string(i)), float(i) - 1);
  Frame f(1, 1);
  buffer.write(f, {}, "CryptoObject", 3);
  EXPECT_EQ(f.layer_names().size(), 2u);
  EXPECT_EQ(f.layer("CryptoObject00").at(0, 0, 0), cryptomatte_id("8"));
  EXPECT_EQ(f.layer("CryptoObject00").at(0, 0, 2), cryptomatte_id("7"));
  EXPECT_EQ(f.layer("CryptoObject01").at(0, 0, 0), cryptomatte_id("6"));
  EXPECT_EQ(f.layer("CryptoObject01").at(0, 0, 2), 0) << "a fourth rank was not asked for";
  Frame g(1, 1);
  buffer.write(g, {}, "CryptoObject", 20);
  EXPECT_EQ(cryptomatte_matte(g, cryptomatte_id("0")).at(0, 0), 0);
  EXPECT_EQ(cryptomatte_matte(g, cryptomatte_id("1")).at(0, 0), 0);
  EXPECT_GT(cryptomatte_matte(g, cryptomatte_id("2")).at(0, 0), 0);
}

TEST_F(Cryptomatte, MergeEqualsOnePass) {
  CryptomatteBuffer whole(1, 1), part(1, 1), other(1, 1);
  for (int i = 0; i < 8; ++i) {
    const float id = i % 3 == 0 ? 0 : cryptomatte_id(std::to_string(i % 3));
    whole.add(0, 0, id, 0.5f);
    (i < 4 ? part : other).add(0, 0, id, 0.5f);
  }
  part.merge(other);
  Frame a(1, 1), b(1, 1);
  whole.write(a, {});
  part.write(b, {});
  EXPECT_EQ(a.layers(), b.layers());
}

TEST_F(Cryptomatte, FilesCarryTheManifest) {
  CryptomatteBuffer buffer(1, 1);
  const std::vector<std::string> names{
      "m\xc3\xa4"
      "dchen",
      "say \"hi\"\\", "cube", "not utf-8 \xff"};
  for (const std::string& n : names) buffer.add(0, 0, cryptomatte_id(n));
  Frame f(1, 1);
  buffer.write(f, names);
  f.create(layers::color());
  write_frame(path("f.exr"), f);
  const Frame g = read_frame(path("f.exr"));
  EXPECT_EQ(f.layers(), g.layers());
  const std::string prefix = "cryptomatte/" + cryptomatte_key("CryptoObject") + "/";
  EXPECT_EQ(std::get<std::string>(g.metadata.at(prefix + "name")), "CryptoObject");
  EXPECT_EQ(std::get<std::string>(g.metadata.at(prefix + "hash")), "MurmurHash3_32");
  EXPECT_EQ(std::get<std::string>(g.metadata.at(prefix + "conversion")), "uint32_to_float32");
  const auto manifest = cryptomatte_manifest(g.metadata);
  EXPECT_EQ(manifest.size(), 4u);
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(manifest.contains(names[i]));
    EXPECT_EQ(manifest.at(names[i]), cryptomatte_id(names[i]));
    EXPECT_EQ(cryptomatte_matte(g, manifest.at(names[i])).at(0, 0), 0.25f);
  }
  EXPECT_EQ(cryptomatte_key("CryptoObject").size(), 7u);
}

TEST_F(Cryptomatte, MissingAndBrokenManifestsAreErrors) {
  Metadata m;
  EXPECT_EQ(test::error_of([&] { cryptomatte_manifest(m); }).code(), ErrorCode::kUnknownName);
  const std::string key = "cryptomatte/" + cryptomatte_key("CryptoObject") + "/manifest";
  for (const char* bad : {"", "{", "[]", "{\"a\":1}", "{\"a\":\"xyz\"}", "{\"a\":\"\"}"}) {
    m[key] = bad;
    EXPECT_EQ(test::error_of([&] { cryptomatte_manifest(m); }).code(), ErrorCode::kBadInput) << bad;
  }
  EXPECT_EQ(test::error_of([&] { cryptomatte_matte(Frame(1, 1), 1); }).code(), ErrorCode::kUnknownName);
}

}  // namespace
}  // namespace tempera
