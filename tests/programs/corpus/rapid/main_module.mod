%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%

MODULE MainModule
  PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  VAR speeddata slow:=[100,50,200,15];
  PROC main()
    ConfL\On;
    MoveAbsJ [[10,-20,30,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\NoEOffs,v1000,z50,tool0;
    MoveJ <0|gun|wobj0>,v1000\V:=1100,z40\Z:=45,gun;
    MoveL <1|gun|wobj0>, slow\T:=5, fine\Inpos:=inpos50, gun\WObj:=wobj0;
    MoveC <2|gun|wobj0>,<3|gun|wobj0>,v500,z30,gun;
    Set do1;
    WaitTime 0.5;
  ENDPROC
ENDMODULE
