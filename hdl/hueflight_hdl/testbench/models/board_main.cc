// SPDX-License-Identifier: Apache-2.0
// Runs a whole generated top by commands from standard input; prints changes of its pins.
//
//   wait PS         let time pass
//   send HEX PS     send bytes on the serial line, 8N1, PS picoseconds a bit
//   trigger LEVEL   set the trigger input
//   pll MODE        state of the PLL, see pll_mode in the models of primitives
//   osc RUNS        stop (0) or start (1) the oscillator
//   reference HALF  half period of the external clock in picoseconds; 0 stops it where it stands
//   period 0        print the last period of the clock output
//   loop CHANNEL PS lead an LED's pin to the trigger input, which it reaches PS picoseconds later
//   flush 0         print a line "now", and let the reader have all lines
//
// Each change is a line: time in picoseconds, "led", "tx", "period" or "now", value. The module
// around a camera prints lines of its own, "word".
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <iostream>
#include <memory>
#include <string>
#include <utility>

#include "Vboard.h"
#include "Vboard__Dpi.h"
#include "verilated.h"

static int mode = 0;
int pll_mode() { return mode; }

struct Board {
    VerilatedContext context;
    std::unique_ptr<Vboard> top{new Vboard(&context)};
    uint64_t now = 0, next_edge = OSC_HALF_PS;
    bool running = true;
    uint64_t reference_half = 0, next_reference = 0, rise = 0, period = 0;
    int led = -1, tx = -1, clock_out = 0;
    int looped = -1;
    uint64_t loop_delay = 0;
    std::deque<std::pair<uint64_t, int>> wire;  // changes on their way to the trigger input

    void settle() {
        context.time(now);
        top->eval();
        if (int value = top->led; value != led) {
            if (looped >= 0 && led >= 0 && ((value ^ led) >> looped & 1))
                wire.emplace_back(now + loop_delay, value >> looped & 1);
            std::printf("%llu led %d\n", (unsigned long long)now, led = value);
        }
        if (int value = top->tx; value != tx)
            std::printf("%llu tx %d\n", (unsigned long long)now, tx = value);
        if (top->clock_out && !clock_out) {
            period = now - rise;
            rise = now;
        }
        clock_out = top->clock_out;
    }

    void wait(uint64_t ps) {
        const uint64_t end = now + ps;
        settle();
        while (now < end) {
            uint64_t next = end;
            if (top->eventsPending()) next = std::min<uint64_t>(next, top->nextTimeSlot());
            if (running) next = std::min(next, next_edge);
            if (reference_half) next = std::min(next, next_reference);
            if (!wire.empty()) next = std::min(next, wire.front().first);
            now = std::max(next, now);
            if (!wire.empty() && now == wire.front().first) {
                top->trigger = wire.front().second;
                wire.pop_front();
            }
            if (running && now == next_edge) {
                top->osc = !top->osc;
                next_edge += OSC_HALF_PS;
            }
            if (reference_half && now == next_reference) {
                top->external_clock = !top->external_clock;
                next_reference += reference_half;
            }
            settle();
        }
    }

    void send(const std::string &hex, uint64_t bit) {
        for (size_t at = 0; at + 1 < hex.size(); at += 2) {
            int frame = std::stoi(hex.substr(at, 2), nullptr, 16) << 1 | 1 << 9;
            for (int i = 0; i < 10; i++, frame >>= 1) {
                top->rx = frame & 1;
                wait(bit);
            }
        }
    }
};

int main() {
    Board board;
    board.top->rx = 1;
    std::string command, hex;
    uint64_t value;
    while (std::cin >> command) {
        if (command == "send") {
            std::cin >> hex >> value;
            board.send(hex, value);
            continue;
        }
        if (command == "loop") {
            std::cin >> board.looped >> board.loop_delay;
            board.wire.clear();
            board.top->trigger = 0;
            continue;
        }
        std::cin >> value;
        if (command == "wait") board.wait(value);
        else if (command == "trigger") board.top->trigger = value;
        else if (command == "pll") mode = value;
        else if (command == "reference") {
            board.reference_half = value;
            board.next_reference = board.now + value;
        } else if (command == "period") {
            std::printf("%llu period %llu\n", (unsigned long long)board.now,
                        (unsigned long long)board.period);
        } else if (command == "flush") {
            std::printf("%llu now 0\n", (unsigned long long)board.now);
            std::fflush(stdout);
        } else if (command == "osc") {
            board.running = value;
            board.next_edge = board.now + OSC_HALF_PS;
        } else {
            std::fprintf(stderr, "unknown command %s\n", command.c_str());
            return 1;
        }
    }
    return 0;
}
