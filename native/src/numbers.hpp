// Rows of comma-separated numbers, or nothing: whatever is unusual is left to the Python reader and its messages.
#pragma once
#include <charconv>
#include <cstddef>

// The count of rows written to ``out``; -1 for text that is not ``width`` plain numbers a line, correctly rounded.
inline long long numbers(const char* at, const char* end, int width, double* out, std::size_t size) {
    auto blank = [](char c) { return c == ' ' || c == '\t'; };
    long long rows = 0;
    std::size_t used = 0;
    while (at < end) {
        const char* line = at;
        for (int k = 0; k < width; k++) {
            while (at < end && blank(*at)) at++;
            const char* digits = at + (at < end && *at == '-');
            // No nan, no inf, no sign of plus: those are Python's to judge.
            if (digits >= end || !((*digits >= '0' && *digits <= '9') || *digits == '.')) return -1;
            if (used == size) return -1;
            const auto [rest, error] = std::from_chars(at, end, out[used]);
            if (error != std::errc()) return -1;
            used++;
            at = rest;
            while (at < end && blank(*at)) at++;
            if (k + 1 < width) {
                if (at >= end || *at != ',') return -1;
                at++;
            }
        }
        if (at < end && *at == '\r') at++;
        if (at < end && *at != '\n') return -1;
        if (at - line >= 1000000) return -1;
        at++;
        rows++;
    }
    return rows;
}
