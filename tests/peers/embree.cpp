// Embree, which `kiln bench rays --peer` compares Kiln's CPU tracer with, on the same triangles and rays.
//
//   g++ -O3 -march=native -std=c++17 tests/peers/embree.cpp -o embree-peer -ldl -pthread
//   pip download --no-deps -d embreex embreex==4.4.0 && unzip -qo embreex/embreex*.whl -d embreex
//   export EMBREE_LIB=$(ls embreex/embreex.libs/libembree4*)
//
//   embree-peer POS IDX RAYS [--stride S] [--reps R] [--threads N] [--robust] [--out HITS]
//
// EMBREE_LIB is any libembree4 of version 4.x; the wheel's is one that is easily had. No header is needed: the few
// types and functions of the API that are used are declared below, as its documentation has them (RTCRay, RTCHit,
// RTCRay8, RTCHit8, RTCIntersectArguments). File formats: docs/benchmarks/rays.md. Every S-th run of 1,024 points is
// traced. Each line of standard output is JSON: the build first, then closest1 (rtcIntersect1), closest8 (packets of
// eight rays of a point), occluded1 and occluded8 (rays as long as 5 % of the diagonal). Rates are the best of R: by
// processor time of the tracing threads, divided by their number, and by the wall.

#include <dlfcn.h>
#include <sys/types.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace {

constexpr uint32_t kNone = ~0u;
constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr size_t kPointsPerStride = 1024, kPointsPerTask = 64;

// The API's types. N lanes: 1 for RTCRay and RTCHit, 8 for RTCRay8 and RTCHit8; arrays lie one after another.
template <int N>
struct alignas(N == 1 ? 16 : 4 * N) Ray {
    float origin[3][N], tnear[N], direction[3][N], time[N], tfar[N];
    uint32_t mask[N], id[N], flags[N];
};
template <int N>
struct alignas(N == 1 ? 16 : 4 * N) Hit {
    float normal[3][N], u[N], v[N];
    uint32_t primitive[N], geometry[N], instance[N], instance_primitive[N];
};
template <int N>
struct RayHit {
    Ray<N> ray;
    Hit<N> hit;
};
static_assert(sizeof(RayHit<1>) == 96 && sizeof(Ray<8>) == 384 && sizeof(Hit<8>) == 288, "Embree's layout");

// RTCIntersectArguments and RTCOccludedArguments: flags, features, context, filter, intersect; room for more.
struct Arguments {
    int flags = 0;
    int features = -1;
    void* rest[8] = {};
};

struct Api {
    void* (*new_device)(const char*);
    int (*device_error)(void*);
    ssize_t (*property)(void*, int);
    void (*monitor)(void*, bool (*)(void*, ssize_t, bool), void*);
    void* (*new_scene)(void*);
    void (*set_quality)(void*, int);
    void (*set_flags)(void*, int);
    void* (*new_geometry)(void*, int);
    void (*share)(void*, int, unsigned, int, const void*, size_t, size_t, size_t);
    void (*commit_geometry)(void*);
    unsigned (*attach)(void*, void*);
    void (*release_geometry)(void*);
    void (*commit_scene)(void*);
    void (*intersect1)(void*, RayHit<1>*, Arguments*);
    void (*intersect8)(const int*, void*, RayHit<8>*, Arguments*);
    void (*occluded1)(void*, Ray<1>*, Arguments*);
    void (*occluded8)(const int*, void*, Ray<8>*, Arguments*);

    explicit Api(const char* path) {
        if (!path) throw std::runtime_error("EMBREE_LIB is not set; see the head of tests/peers/embree.cpp");
        void* library = dlopen(path, RTLD_NOW);
        if (!library) throw std::runtime_error(std::string(dlerror()) + "; set EMBREE_LIB to a libembree4");
        const auto find = [&](auto& function, const char* name) {
            void* found = dlsym(library, name);
            if (!found) throw std::runtime_error(std::string(path) + " has no " + name + "; Embree 4 is needed");
            std::memcpy(&function, &found, sizeof found);
        };
        find(new_device, "rtcNewDevice");
        find(device_error, "rtcGetDeviceError");
        find(property, "rtcGetDeviceProperty");
        find(monitor, "rtcSetDeviceMemoryMonitorFunction");
        find(new_scene, "rtcNewScene");
        find(set_quality, "rtcSetSceneBuildQuality");
        find(set_flags, "rtcSetSceneFlags");
        find(new_geometry, "rtcNewGeometry");
        find(share, "rtcSetSharedGeometryBuffer");
        find(commit_geometry, "rtcCommitGeometry");
        find(attach, "rtcAttachGeometry");
        find(release_geometry, "rtcReleaseGeometry");
        find(commit_scene, "rtcCommitScene");
        find(intersect1, "rtcIntersect1");
        find(intersect8, "rtcIntersect8");
        find(occluded1, "rtcOccluded1");
        find(occluded8, "rtcOccluded8");
    }
};

template <class T>
std::vector<T> take(std::ifstream& in, size_t count, const std::string& path) {
    std::vector<T> values(count);
    in.read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(count * sizeof(T)));
    if (!in) throw std::runtime_error(path + " ends too early; write it again");
    return values;
}

std::ifstream open(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    if (!in) throw std::runtime_error(path + " cannot be read");
    return in;
}

template <class T>
std::vector<T> read_all(const std::string& path) {
    std::ifstream in = open(path);
    in.seekg(0, std::ios::end);
    const size_t bytes = static_cast<size_t>(in.tellg());
    in.seekg(0);
    if (bytes % (3 * sizeof(T)) != 0) throw std::runtime_error(path + " is no list of triples");
    return take<T>(in, bytes / sizeof(T), path);
}

struct Rays {
    size_t points = 0, per_point = 0;
    float diagonal = 0;
    std::vector<float> origin, direction;

    explicit Rays(const std::string& path) {
        std::ifstream in = open(path);
        const std::vector<uint32_t> counts = take<uint32_t>(in, 2, path);
        points = counts[0];
        per_point = counts[1];
        diagonal = take<float>(in, 1, path)[0];
        origin = take<float>(in, 3 * points, path);
        take<float>(in, 3 * points, path);  // normals
        direction = take<float>(in, 3 * points * per_point, path);
        if (direction.empty()) throw std::runtime_error(path + " has no rays");
    }
};

struct Options {
    std::vector<std::string> files;
    uint64_t stride = 1, reps = 3, threads = 1;
    bool robust = false;
    std::string out;

    Options(int count, char** words) {
        for (int i = 1; i < count; ++i) {
            const std::string word = words[i];
            const auto value = [&]() -> std::string {
                if (++i == count) throw std::runtime_error(word + " needs a value");
                return words[i];
            };
            if (word == "--stride") stride = std::stoull(value());
            else if (word == "--reps") reps = std::stoull(value());
            else if (word == "--threads") threads = std::stoull(value());
            else if (word == "--robust") robust = true;
            else if (word == "--out") out = value();
            else if (word.rfind("--", 0) == 0) throw std::runtime_error("unknown option " + word);
            else files.push_back(word);
        }
        if (files.size() != 3 || !stride || !reps || !threads)
            throw std::runtime_error("embree-peer POS IDX RAYS [--stride S] [--reps R] [--threads N] [--robust] [--out HITS]");
    }
};

// What Embree has allocated, as it tells; calls come from several threads.
struct Memory {
    std::atomic<int64_t> now{0}, peak{0};

    static bool change(void* self, ssize_t bytes, bool) {
        Memory& memory = *static_cast<Memory*>(self);
        const int64_t now = memory.now += bytes;
        for (int64_t peak = memory.peak; peak < now && !memory.peak.compare_exchange_weak(peak, now);) {}
        return true;
    }
};

double thread_seconds() {
    timespec time{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

double seconds_since(std::chrono::steady_clock::time_point start) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

struct Tally {
    uint64_t rays = 0, hits = 0;
    double distance = 0, cpu_seconds = 0;

    void operator+=(const Tally& other) {
        rays += other.rays;
        hits += other.hits;
        distance += other.distance;
        cpu_seconds += other.cpu_seconds;
    }
};

// A committed scene and the rays for it.
struct Course {
    const Api& api;
    void* scene;
    const Rays& rays;

    // A query of rays of one point, of which the first `lanes` lanes are used.
    template <int N>
    RayHit<N> aim(size_t ray, int lanes, float tfar) const {
        RayHit<N> query{};
        const float* origin = &rays.origin[ray / rays.per_point * 3];
        const float* direction = &rays.direction[ray * 3];
        for (int axis = 0; axis < 3; ++axis) {
            std::fill_n(query.ray.origin[axis], N, origin[axis]);
            for (int lane = 0; lane < lanes; ++lane) query.ray.direction[axis][lane] = direction[3 * lane + axis];
        }
        std::fill_n(query.ray.tfar, N, tfar);
        std::fill_n(query.ray.mask, N, kNone);
        std::fill_n(query.hit.geometry, N, kNone);
        std::fill_n(query.hit.instance, N, kNone);
        return query;
    }

    void ask(RayHit<1>& query, const int*, bool closest, Arguments& arguments) const {
        if (closest) api.intersect1(scene, &query, &arguments);
        else api.occluded1(scene, &query.ray, &arguments);
    }

    void ask(RayHit<8>& query, const int* valid, bool closest, Arguments& arguments) const {
        if (closest) api.intersect8(valid, scene, &query, &arguments);
        else api.occluded8(valid, scene, &query.ray, &arguments);
    }

    // Traces the rays of one point, N at a time.
    template <int N>
    void trace(size_t point, bool closest, float tfar, Tally& tally) const {
        Arguments arguments;
        const size_t end = (point + 1) * rays.per_point;
        for (size_t ray = point * rays.per_point; ray < end; ray += N) {
            const int lanes = static_cast<int>(std::min<size_t>(N, end - ray));
            RayHit<N> query = aim<N>(ray, lanes, tfar);
            alignas(32) int valid[N] = {};
            std::fill_n(valid, lanes, -1);
            ask(query, valid, closest, arguments);
            for (int lane = 0; lane < lanes; ++lane) {
                const float t = query.ray.tfar[lane];
                const bool hit = closest ? query.hit.geometry[lane] != kNone : t < 0;
                tally.hits += hit;
                if (hit && closest) tally.distance += static_cast<double>(t);
            }
            tally.rays += static_cast<uint64_t>(lanes);
        }
    }

    // All chosen points on so many threads; the wall seconds.
    double run(int lanes, bool closest, const Options& options, Tally& total) const {
        const size_t runs = (rays.points + kPointsPerStride - 1) / kPointsPerStride;
        const size_t stride = std::min<size_t>(options.stride, runs), chosen = (runs + stride - 1) / stride;
        const size_t tasks_per_run = kPointsPerStride / kPointsPerTask;
        const float tfar = closest ? kInfinity : 0.05f * rays.diagonal;
        std::atomic<size_t> next{0};
        std::vector<Tally> tallies(options.threads);
        const auto work = [&](Tally& tally) {
            const double begin = thread_seconds();
            for (size_t task; (task = next++) / tasks_per_run < chosen;) {
                const size_t run = task / tasks_per_run * stride;
                const size_t first = run * kPointsPerStride + task % tasks_per_run * kPointsPerTask;
                for (size_t point = first; point < std::min(first + kPointsPerTask, rays.points); ++point)
                    lanes == 1 ? trace<1>(point, closest, tfar, tally) : trace<8>(point, closest, tfar, tally);
            }
            tally.cpu_seconds = thread_seconds() - begin;
        };
        const auto start = std::chrono::steady_clock::now();
        std::vector<std::thread> threads;
        for (Tally& tally : tallies) threads.emplace_back([&] { Tally mine; work(mine); tally = mine; });
        for (std::thread& thread : threads) thread.join();
        const double wall = seconds_since(start);
        for (const Tally& tally : tallies) total += tally;
        return wall;
    }

    void print_rates(const char* mode, int lanes, bool closest, const Options& options) const {
        double cpu = kInfinity, wall = kInfinity;
        Tally last;
        for (uint64_t rep = 0; rep < options.reps; ++rep) {
            last = Tally();
            wall = std::min(wall, run(lanes, closest, options, last));
            cpu = std::min(cpu, last.cpu_seconds / static_cast<double>(options.threads));
        }
        const double rays_traced = static_cast<double>(last.rays);
        std::printf("{\"mode\":\"%s\",\"rays\":%llu,\"hit_fraction\":%.6f,\"mean_t\":%.6f,"
                    "\"mrays_per_cpu_second\":%.4f,\"mrays_per_wall_second\":%.4f}\n",
                    mode, static_cast<unsigned long long>(last.rays), static_cast<double>(last.hits) / rays_traced,
                    last.hits ? last.distance / static_cast<double>(last.hits) : 0.0, 1e-6 * rays_traced / cpu,
                    1e-6 * rays_traced / wall);
        std::fflush(stdout);
    }

    // For each ray f32 t, u32 triangle, u32 flags (1: back).
    void write_hits(const std::string& path) const {
        std::vector<uint32_t> words;
        words.reserve(rays.direction.size());
        Arguments arguments;
        for (size_t ray = 0; ray < rays.points * rays.per_point; ++ray) {
            RayHit<1> query = aim<1>(ray, 1, kInfinity);
            ask(query, nullptr, true, arguments);
            const bool hit = query.hit.geometry[0] != kNone;
            double along = 0;
            for (int axis = 0; hit && axis < 3; ++axis)
                along += static_cast<double>(query.hit.normal[axis][0]) * static_cast<double>(query.ray.direction[axis][0]);
            const float t = hit ? query.ray.tfar[0] : kInfinity;
            uint32_t bits;
            std::memcpy(&bits, &t, 4);
            words.insert(words.end(), {bits, hit ? query.hit.primitive[0] : kNone, along > 0 ? 1u : 0u});
        }
        std::ofstream file(path, std::ios::binary);
        file.write(reinterpret_cast<const char*>(words.data()), static_cast<std::streamsize>(4 * words.size()));
        if (!file.flush()) throw std::runtime_error(path + " cannot be written");
    }
};

// One geometry of all triangles, built with medium quality.
void* build(const Api& api, void* device, const std::vector<float>& positions, const std::vector<uint32_t>& triangles,
            bool robust) {
    constexpr int kMedium = 1, kRobust = 1 << 2, kTriangles = 0, kIndex = 0, kVertex = 1;
    constexpr int kUint3 = 0x5003, kFloat3 = 0x9003;
    void* scene = api.new_scene(device);
    api.set_quality(scene, kMedium);
    api.set_flags(scene, robust ? kRobust : 0);
    void* geometry = api.new_geometry(device, kTriangles);
    api.share(geometry, kIndex, 0, kUint3, triangles.data(), 0, 12, triangles.size() / 3);
    // Positions have room behind them, since Embree reads 16 bytes of each.
    api.share(geometry, kVertex, 0, kFloat3, positions.data(), 0, 12, positions.size() / 3 - 2);
    api.commit_geometry(geometry);
    api.attach(scene, geometry);
    api.release_geometry(geometry);
    api.commit_scene(scene);
    if (const int error = api.device_error(device)) throw std::runtime_error("Embree error " + std::to_string(error));
    return scene;
}

void run(const Options& options) {
    std::vector<float> positions = read_all<float>(options.files[0]);
    positions.resize(positions.size() + 6, 0.0f);
    const std::vector<uint32_t> triangles = read_all<uint32_t>(options.files[1]);
    const Rays rays(options.files[2]);
    const Api api(std::getenv("EMBREE_LIB"));
    void* device = api.new_device(("threads=" + std::to_string(options.threads)).c_str());
    if (!device) throw std::runtime_error("Embree cannot open a device");
    Memory memory;
    api.monitor(device, Memory::change, &memory);
    const auto start = std::chrono::steady_clock::now();
    void* scene = build(api, device, positions, triangles, options.robust);
    const double seconds = seconds_since(start);
    std::printf("{\"embree\":%lld,\"triangles\":%zu,\"build_seconds\":%.4f,\"threads\":%llu,\"memory_bytes\":%lld,"
                "\"peak_bytes\":%lld}\n",
                static_cast<long long>(api.property(device, 0)), triangles.size() / 3, seconds,
                static_cast<unsigned long long>(options.threads), static_cast<long long>(memory.now),
                static_cast<long long>(memory.peak));
    const Course course{api, scene, rays};
    if (!options.out.empty()) course.write_hits(options.out);
    course.print_rates("closest1", 1, true, options);
    course.print_rates("closest8", 8, true, options);
    course.print_rates("occluded1", 1, false, options);
    course.print_rates("occluded8", 8, false, options);
}

}  // namespace

int main(int count, char** words) {
    try {
        run(Options(count, words));
        return 0;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "embree-peer: %s\n", error.what());
        return 1;
    }
}
