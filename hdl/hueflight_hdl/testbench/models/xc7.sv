// SPDX-License-Identifier: Apache-2.0
// Behavioural models of the 7-series primitives that the boards use, for simulation of a whole
// generated top. Function and order of bits follow Xilinx UG471 (SelectIO: ISERDESE2, OSERDESE2)
// and UG472 (clocking: PLLE2_BASE, BUFGCE); there are no delays, and the latency of the serialisers
// is that of their registers here, not the one of the device.

// State of the PLL as the testbench wants it: 0 works, 1 loses lock and goes on oscillating, 2
// loses lock and stops.
import "DPI-C" function int pll_mode();

module PLLE2_BASE #(
    parameter real CLKIN1_PERIOD = 10.0,
    parameter integer CLKFBOUT_MULT = 8,
    parameter integer DIVCLK_DIVIDE = 1,
    parameter integer CLKOUT0_DIVIDE = 1,
    parameter integer CLKOUT1_DIVIDE = 1,
    parameter integer CLKOUT2_DIVIDE = 1
) (
    input CLKIN1, CLKFBIN, RST, PWRDWN,
    output CLKFBOUT,
    output reg CLKOUT0, CLKOUT1, CLKOUT2, LOCKED
);
    localparam integer LOCK_HALVES = 3200;
    longint last_edge, period, half, vco_khz;
    integer edges, steady, halves;
    assign CLKFBOUT = CLKOUT0;

    initial begin
        CLKOUT0 = 0; CLKOUT1 = 0; CLKOUT2 = 0; LOCKED = 0;
        last_edge = 0; period = 0; half = 0; vco_khz = 0; edges = 0; steady = 0; halves = 0;
    end

    always @(posedge CLKIN1) begin
        period = $time - last_edge;
        last_edge = $time;
        if (edges < 4) edges = edges + 1;
        half = period * DIVCLK_DIVIDE / CLKFBOUT_MULT / 2;
        vco_khz = 64'd500000000 / half;
    end

    always begin
        if (edges < 4 || RST || pll_mode() == 2 || $time - last_edge > 3 * period) begin
            LOCKED = 0;
            steady = 0;
            #1000;
        end else begin
            #(half);
            // data sheet, slowest speed grade: the oscillator runs from 800 to 1600 MHz
            if (pll_mode() != 0 || vco_khz < 800000 || vco_khz > 1600000) begin
                LOCKED = 0;
                steady = 0;
            end else if (steady < LOCK_HALVES) steady = steady + 1;
            else LOCKED = 1;
            if (halves % CLKOUT0_DIVIDE == 0) CLKOUT0 = ~CLKOUT0;
            if (halves % CLKOUT1_DIVIDE == 0) CLKOUT1 = ~CLKOUT1;
            if (halves % CLKOUT2_DIVIDE == 0) CLKOUT2 = ~CLKOUT2;
            halves = halves + 1;
        end
    end
endmodule

module BUFG (input I, output O);
    assign O = I;
endmodule

module BUFGCE (input I, CE, output O);
    reg enabled = 0;
    always @(negedge I) enabled <= CE;
    assign O = I & enabled;
endmodule

module FDPE #(parameter [0:0] INIT = 1) (input C, CE, PRE, D, output reg Q);
    initial Q = INIT;
    always @(posedge C or posedge PRE)
        if (PRE) Q <= 1;
        else if (CE) Q <= D;
endmodule

module IBUF (input I, output O);
    assign O = I;
endmodule

// A released pin is low: its pull-down is on.
module OBUFT (input I, T, output O);
    assign O = T ? 1'b0 : I;
endmodule

// A word is taken with CLKDIV, moved to CLK, and sent D1 first at both of its edges.
module OSERDESE2 #(
    parameter DATA_RATE_OQ = "DDR", DATA_RATE_TQ = "BUF", SERDES_MODE = "MASTER",
    parameter integer DATA_WIDTH = 4, TRISTATE_WIDTH = 1,
    parameter [0:0] INIT_OQ = 0, SRVAL_OQ = 0, INIT_TQ = 1, SRVAL_TQ = 1
) (
    input CLK, CLKDIV, RST, OCE, TCE, D1, D2, D3, D4, D5, D6, D7, D8, T1, T2, T3, T4, TBYTEIN,
    input SHIFTIN1, SHIFTIN2,
    output OQ, TQ
);
    reg [3:0] word = 0, moved = 0;
    reg [1:0] now = {2{INIT_OQ}};
    reg phase = 0;
    initial if (DATA_RATE_OQ != "DDR" || DATA_RATE_TQ != "BUF" || DATA_WIDTH != 4)
        $fatal(1, "OSERDESE2: only 4 bits at double data rate are modelled");
    always @(posedge CLKDIV or posedge RST)
        if (RST) word <= 0;
        else if (OCE) word <= {D4, D3, D2, D1};
    always @(posedge CLK or posedge RST)
        if (RST) begin
            phase <= 0;
            moved <= 0;
            now <= {2{SRVAL_OQ}};
        end else begin
            phase <= ~phase;
            if (phase) moved <= word;
            now <= phase ? moved[3:2] : moved[1:0];
        end
    assign OQ = CLK ? now[0] : now[1];
    assign TQ = T1;
endmodule

// Both edges are sampled; the word of four goes to CLKDIV, Q1 the latest.
module ISERDESE2 #(
    parameter DATA_RATE = "DDR", INTERFACE_TYPE = "NETWORKING", IOBDELAY = "NONE",
    parameter SERDES_MODE = "MASTER",
    parameter integer DATA_WIDTH = 4, NUM_CE = 1
) (
    input D, DDLY, CLK, CLKB, CLKDIV, CLKDIVP, OCLK, OCLKB, RST, BITSLIP, CE1, CE2,
    input SHIFTIN1, SHIFTIN2, OFB, DYNCLKSEL, DYNCLKDIVSEL,
    output reg Q1, Q2, Q3, Q4
);
    reg rise = 0, fall = 0;
    reg [3:0] samples = 0, word = 0;
    initial begin
        {Q1, Q2, Q3, Q4} = 0;
        if (DATA_RATE != "DDR" || DATA_WIDTH != 4 || IOBDELAY != "NONE")
            $fatal(1, "ISERDESE2: only 4 bits at double data rate are modelled");
    end
    always @(posedge CLK) rise <= D;
    always @(posedge CLKB) fall <= D;
    always @(posedge CLK) samples <= {fall, rise, samples[3:2]};
    always @(posedge CLKDIV) word <= samples;
    always @(posedge CLKDIV or posedge RST)
        if (RST) {Q1, Q2, Q3, Q4} <= 0;
        else {Q1, Q2, Q3, Q4} <= word;
endmodule
