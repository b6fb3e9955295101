// Arrays from Python, checked: a wrong one is a TypeError or ValueError that names it.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <initializer_list>
#include <string>

namespace gsyn {

namespace nb = nanobind;

using Array = nb::ndarray<>;               // any array on any device, to be checked
using ReadArray = nb::ndarray<nb::ro>;     // the same, read only

constexpr int64_t ANY = -1;

inline std::string shape_text(std::initializer_list<int64_t> shape) {
    std::string text = "[";
    for (int64_t size : shape) {
        if (text.size() > 1) text += ", ";
        text += size == ANY ? "*" : std::to_string(size);
    }
    return text + "]";
}

// The data of a C-contiguous CPU array of this element type and shape.
template <class T, class AnyArray>
T *checked(const AnyArray &array, const char *name, std::initializer_list<int64_t> shape) {
    if (array.dtype() != nb::dtype<std::remove_const_t<T>>()) {
        throw nb::type_error((std::string(name) + ": wrong element type").c_str());
    }
    if (array.device_type() != nb::device::cpu::value) {
        throw nb::type_error((std::string(name) + ": must be on the CPU").c_str());
    }
    bool fits = array.ndim() == shape.size();
    std::string found = "[";
    for (size_t i = 0; i < array.ndim(); i++) {
        found += (i ? ", " : "") + std::to_string(array.shape(i));
        const int64_t expected = fits ? shape.begin()[i] : ANY;
        if (expected != ANY && expected != static_cast<int64_t>(array.shape(i))) fits = false;
    }
    if (!fits) {
        throw nb::value_error((std::string(name) + ": found shape " + found + "], expected " +
                               shape_text(shape)).c_str());
    }
    int64_t stride = 1;
    for (size_t i = array.size() ? array.ndim() : 0; i-- > 0;) {
        if (array.shape(i) > 1 && array.stride(i) != stride) {
            throw nb::value_error((std::string(name) + ": must be contiguous").c_str());
        }
        stride *= static_cast<int64_t>(array.shape(i));
    }
    return static_cast<T *>(array.data());
}

inline int checked_threads(int threads) {
    if (threads < 1 || threads > 1024) throw nb::value_error("threads: expected 1 to 1024");
    return threads;
}

}  // namespace gsyn
