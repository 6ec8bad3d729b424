// The direct solvers that `kiln bench solve --peer` compares Kiln with, on the same matrices and right-hand sides,
// all with AMD's ordering: CHOLMOD (supernodal and simplicial) and Eigen's SimplicialLDLT.
//
//   apt-get install libsuitesparse-dev libeigen3-dev libopenblas-dev
//   g++ -O3 -march=native -std=c++17 -I/usr/include/eigen3 -I/usr/include/suitesparse tests/peers/solve.cpp -o solve-peer -lcholmod -lopenblas
//
//   solve-peer cholmod|cholmod-simplicial|eigen SYSTEM X
//
// SYSTEM (little-endian): "kilnSYS1", u64 unknowns n, u64 entries, u64 columns k; u32 column starts (n + 1), u32
// rows, f64 values of the lower triangle in compressed columns; f64 right-hand sides, the k of one unknown
// together; more that only Kiln reads. X gets the answer, f64, shaped as the right-hand sides. One line of JSON
// goes to standard output. Time is that of ordering, factorisation and solve; CPU time is of all threads.

#include <cholmod.h>

#include <Eigen/Sparse>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

struct System {
    uint64_t n = 0, entries = 0, columns = 0;
    std::vector<int32_t> start, row;
    std::vector<double> value;
    std::vector<double> rhs;  // by column
};

template <class T>
void read(std::ifstream& in, T* to, uint64_t count) {
    in.read(reinterpret_cast<char*>(to), static_cast<std::streamsize>(count * sizeof(T)));
    if (!in) throw std::runtime_error("the system file ends too early; write it again");
}

System read_system(const char* path) {
    std::ifstream in(path, std::ios::binary);
    char magic[8];
    read(in, magic, 8);
    if (std::memcmp(magic, "kilnSYS1", 8) != 0) throw std::runtime_error("this is no system file of kiln bench solve");
    System system;
    read(in, &system.n, 1);
    read(in, &system.entries, 1);
    read(in, &system.columns, 1);
    system.start.resize(system.n + 1);
    system.row.resize(system.entries);
    system.value.resize(system.entries);
    read(in, system.start.data(), system.n + 1);
    read(in, system.row.data(), system.entries);
    read(in, system.value.data(), system.entries);
    system.rhs.resize(system.n * system.columns);
    std::vector<double> of_unknown(system.columns);
    for (uint64_t i = 0; i < system.n; ++i) {
        read(in, of_unknown.data(), system.columns);
        for (uint64_t c = 0; c < system.columns; ++c) system.rhs[c * system.n + i] = of_unknown[c];
    }
    return system;
}

void write_answer(const char* path, const System& system, const double* x) {
    std::ofstream out(path, std::ios::binary);
    std::vector<double> of_unknown(system.columns);
    for (uint64_t i = 0; i < system.n; ++i) {
        for (uint64_t c = 0; c < system.columns; ++c) of_unknown[c] = x[c * system.n + i];
        out.write(reinterpret_cast<const char*>(of_unknown.data()),
                  static_cast<std::streamsize>(system.columns * sizeof(double)));
    }
    if (!out) throw std::runtime_error("the answer cannot be written");
}

double cpu_secs() {
    timespec t{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

double wall_secs() {
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

uint64_t status_kib(const std::string& key) {
    std::ifstream in("/proc/self/status");
    for (std::string line; std::getline(in, line);)
        if (line.rfind(key, 0) == 0) return std::strtoull(line.c_str() + key.size(), nullptr, 10);
    return 0;
}

struct Clock {
    double cpu = cpu_secs(), wall = wall_secs();
    uint64_t resident_kib = status_kib("VmRSS:");

    void report(const std::string& solver, double factor_entries) const {
        std::printf(
            "{\"solver\":\"%s\",\"cpu_secs\":%.6f,\"wall_secs\":%.6f,\"input_kib\":%llu,\"peak_kib\":%llu,"
            "\"factor_entries\":%.0f}\n",
            solver.c_str(), cpu_secs() - cpu, wall_secs() - wall, static_cast<unsigned long long>(resident_kib),
            static_cast<unsigned long long>(status_kib("VmHWM:")), factor_entries);
    }
};

void by_cholmod(System& system, bool supernodal, const char* answer) {
    cholmod_common common;
    cholmod_start(&common);
    common.supernodal = supernodal ? CHOLMOD_SUPERNODAL : CHOLMOD_SIMPLICIAL;
    common.nmethods = 1;
    common.method[0].ordering = CHOLMOD_AMD;
    common.postorder = 1;
    cholmod_sparse a{};
    a.nrow = a.ncol = system.n;
    a.nzmax = system.entries;
    a.p = system.start.data();
    a.i = system.row.data();
    a.x = system.value.data();
    a.stype = -1;
    a.itype = CHOLMOD_INT;
    a.xtype = CHOLMOD_REAL;
    a.dtype = CHOLMOD_DOUBLE;
    a.sorted = 1;
    a.packed = 1;
    cholmod_dense b{};
    b.nrow = b.d = system.n;
    b.ncol = system.columns;
    b.nzmax = system.rhs.size();
    b.x = system.rhs.data();
    b.xtype = CHOLMOD_REAL;
    b.dtype = CHOLMOD_DOUBLE;
    const Clock clock;
    cholmod_factor* factor = cholmod_analyze(&a, &common);
    if (factor == nullptr || !cholmod_factorize(&a, factor, &common) || common.status != CHOLMOD_OK)
        throw std::runtime_error("CHOLMOD could not factorise the matrix");
    cholmod_dense* x = cholmod_solve(CHOLMOD_A, factor, &b, &common);
    if (x == nullptr) throw std::runtime_error("CHOLMOD could not solve");
    clock.report(supernodal ? "CHOLMOD supernodal" : "CHOLMOD simplicial", common.lnz);
    write_answer(answer, system, static_cast<const double*>(x->x));
    cholmod_free_dense(&x, &common);
    cholmod_free_factor(&factor, &common);
    cholmod_finish(&common);
}

void by_eigen(System& system, const char* answer) {
    const auto n = static_cast<Eigen::Index>(system.n);
    const Eigen::Map<const Eigen::SparseMatrix<double>> a(n, n, static_cast<Eigen::Index>(system.entries),
                                                          system.start.data(), system.row.data(),
                                                          system.value.data());
    const Eigen::Map<const Eigen::MatrixXd> b(system.rhs.data(), n, static_cast<Eigen::Index>(system.columns));
    const Clock clock;
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>, Eigen::Lower> ldlt(a);
    if (ldlt.info() != Eigen::Success) throw std::runtime_error("Eigen could not factorise the matrix");
    const Eigen::MatrixXd x = ldlt.solve(b);
    clock.report("Eigen SimplicialLDLT", static_cast<double>(ldlt.matrixL().nestedExpression().nonZeros()));
    write_answer(answer, system, x.data());
}

}  // namespace

int main(int argc, char** argv) try {
    if (argc != 4) throw std::runtime_error("usage: solve-peer cholmod|cholmod-simplicial|eigen SYSTEM X");
    System system = read_system(argv[2]);
    const std::string solver = argv[1];
    if (solver == "cholmod" || solver == "cholmod-simplicial") {
        by_cholmod(system, solver == "cholmod", argv[3]);
    } else if (solver == "eigen") {
        by_eigen(system, argv[3]);
    } else {
        throw std::runtime_error(solver + " is no solver: cholmod, cholmod-simplicial or eigen");
    }
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
