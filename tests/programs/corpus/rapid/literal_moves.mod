MODULE LiteralMoves
  PROC teach()
    MoveJ <28|torch|wobj0>,v1000,z50,torch;
    MoveL <29|torch|table>,v200\T:=2.5,fine\Inpos:=inpos20,torch\WObj:=table;
    MoveC <30|torch|table>,<31|torch|table>,v100,z5,torch\WObj:=table;
    MoveL Offs(<31|torch|table>,0,0,100),v100,z5,torch\WObj:=table;
    MoveAbsJ [[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z5,tool0;
  ENDPROC
ENDMODULE
